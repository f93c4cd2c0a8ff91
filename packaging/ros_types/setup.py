"""Type supports of control_msgs and tf2_msgs, made by the generators of ROS 2 and a C++ compiler.

Five libraries and a module for each package, as ``ament_cmake`` builds them. They lie in the
package's folder, beside each other: the module loads all, so that ROS 2 finds them by name.
"""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import numpy as np
import rosidl_generator_c
from rosidl_adapter.action import convert_action_to_idl
from rosidl_adapter.msg import convert_msg_to_idl
from rosidl_generator_c.cli import GenerateC
from rosidl_generator_py.cli import GeneratePython
from rosidl_generator_type_description.cli import HashTypeDescription
from rosidl_typesupport_c.cli import GenerateCTypesupport
from rosidl_typesupport_fastrtps_c.cli import GenerateFastRTPSCTypesupport
from rosidl_typesupport_introspection_c.cli import GenerateIntrospectionCTypesupport
from setuptools import Extension, setup
from setuptools.command.build_ext import build_ext

DEFINITIONS = Path(__file__).parent.absolute() / "definitions"
ROS = Path(rosidl_generator_c.__file__).parents[4]
"""Prefix of the wheels of ROS 2: headers, libraries and definitions."""

NEEDED = (
    *("action_msgs", "builtin_interfaces", "geometry_msgs", "service_msgs", "std_msgs"),
    *("trajectory_msgs", "unique_identifier_msgs"),
)
"""Packages whose messages are parts of ours."""

CORE = (
    *("rosidl_runtime_c", "rosidl_typesupport_c", "rosidl_typesupport_fastrtps_c"),
    *("rosidl_typesupport_fastrtps_cpp", "rosidl_typesupport_introspection_c"),
    *("fastcdr", "rmw", "rcutils"),
)

LIBRARIES = {
    "rosidl_generator_c": GenerateC,
    "rosidl_typesupport_fastrtps_c": GenerateFastRTPSCTypesupport,
    "rosidl_typesupport_introspection_c": GenerateIntrospectionCTypesupport,
    "rosidl_typesupport_c": GenerateCTypesupport,
    "rosidl_generator_py": GeneratePython,
}
"""Generator of each library's sources; a library uses those before it."""


class BuildTypes(build_ext):
    """Build all of a package, where setuptools would build a module from its sources."""

    def build_extension(self, ext: Extension) -> None:
        """Generate and compile a package; ``ext`` names its module."""
        os.environ["AMENT_PREFIX_PATH"] = str(ROS)
        package = ext.name.partition(".")[0]
        target = Path(self.get_ext_fullpath(ext.name)).parent.absolute()
        work = Path(self.build_temp, package).absolute()
        shutil.rmtree(work, ignore_errors=True)
        target.mkdir(parents=True, exist_ok=True)
        self._generate(package, work)
        python = work / "rosidl_generator_py" / package
        (target / "__init__.py").touch()
        for file in python.glob("*/*.py"):
            (target / file.parent.name).mkdir(exist_ok=True)
            shutil.copy(file, target / file.parent.name)
        made: list[str] = []
        for name in LIBRARIES:
            sources = [*(work / name).rglob("*.c"), *(work / name).rglob("*.cpp")]
            sources = [source for source in sources if ".ep." not in source.name]
            self._link(work, sources, target / f"lib{package}__{name}.so", name, made)
            made.append(f"{package}__{name}")
        module = python / f"_{package}_s.ep.rosidl_typesupport_c.c"
        made_all = ["-Wl,--no-as-needed", *(f"-l{name}" for name in made)]
        path = target / Path(self.get_ext_fullpath(ext.name)).name
        self._link(work, [module], path, "rosidl_typesupport_c", [], made_all)

    def _generate(self, package: str, work: Path) -> None:
        """Write the sources of all libraries, each in its own folder."""
        idl = work / "idl" / package
        files = []
        for file in sorted((DEFINITIONS / package).glob("*/*")):
            convert = convert_action_to_idl if file.suffix == ".action" else convert_msg_to_idl
            name = file.relative_to(DEFINITIONS / package)
            convert(DEFINITIONS / package, package, name, idl / name.parent)
            files.append(f"{idl}:{name.with_suffix('.idl')}")
        others = [ROS / "share"]
        hashes = HashTypeDescription("hash").generate_type_hashes(
            package, files, others, work / "hashes" / package
        )
        for name, generator in LIBRARIES.items():
            described = {"type_description_files": hashes} if generator is GenerateC else {}
            generator(name).generate(package, files, others, work / name / package, **described)

    def _link(
        self,
        work: Path,
        sources: list[Path],
        target: Path,
        kind: str,
        libraries: list[str],
        first: list[str] | None = None,
    ) -> None:
        """Compile sources to a library, which finds others in its folder and in that of ROS 2."""
        # fastcdr's headers lie in the folder itself, those of the other packages one below.
        own, theirs = [work / name for name in LIBRARIES], ROS / "include"
        headers = [*own, theirs, *theirs.iterdir()]
        objects = self.compiler.compile(
            [str(source) for source in sources],
            output_dir=str(work / "objects" / kind),
            include_dirs=[*map(str, headers), *self.include_dirs, np.get_include()],
            extra_postargs=["-O2", "-fPIC", "-w"],
        )
        self.compiler.link_shared_object(
            objects,
            str(target),
            libraries=[*libraries, *(f"{name}__{kind}" for name in NEEDED), *CORE],
            library_dirs=[str(target.parent), str(ROS / "lib")],
            extra_preargs=[
                f"-Wl,-soname,{target.name}",
                "-Wl,--disable-new-dtags,-rpath,$ORIGIN:$ORIGIN/../../..",
                *(first or ()),
                "-Wl,--as-needed",
            ],
            target_lang="c++",
        )


setup(
    ext_modules=[
        Extension(f"{package.name}.{package.name}_s__rosidl_typesupport_c", sources=[])
        for package in sorted(DEFINITIONS.iterdir())
    ],
    packages=[],
    cmdclass={"build_ext": BuildTypes},
)
