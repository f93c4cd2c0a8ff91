"""Export of a volume of a run, or of a measured scan, for other programs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from twinct import scenario as sections
from twinct.core.errors import InputError, ScanExistsError
from twinct.core.files.writing import require_space
from twinct.core.foreign_text import quoted
from twinct.observers import Audience, Observers, audience_of
from twinct.recon.volume import Volume
from twinct.recon.volume_formats import VolumeFacts, volume_format_named
from twinct.runs.folder import Folder, refuse_result
from twinct.runs.reconstruction import load_scan
from twinct.runs.regions import Places
from twinct.scan import ScanStore, SimulationBuilder
from twinct.scenario.imported import ScanSettings
from twinct.specimen.materials import material
from twinct.xray.build import effective_energy_kev

VolumeValues = Literal["attenuation", "hounsfield"]

MOST_WATER_PER_MM = 5.0
"""Largest attenuation of water, 1/mm: that of photons of 5 keV is 4.2."""

OWN_VOLUME, TRUTH = "volume", "truth"
"""Names of the run's own volume and of its truth; other names are further reconstructions."""


@dataclass(frozen=True)
class Water:
    """Attenuation of water and of air in a volume, 1/mm, which define its HU."""

    water_per_mm: float
    air_per_mm: float = 0.0

    @property
    def in_words(self) -> str:
        """The unit of the values, and what defines it."""
        return f"HU by water of {self.water_per_mm:.6g}/mm and air of {self.air_per_mm:.6g}/mm"


def export_volume(
    path: str | Path,
    volume: str,
    to: str,
    *,
    values: VolumeValues | None = None,
    water: Water | None = None,
    out: str | Path | None = None,
    observers: Observers = (),
) -> Path:
    """Write a volume in a format for other programs, and return its file or folder.

    Args:
        path: folder of a run, or of a measured scan.
        volume: ``volume``, ``truth``, or the name of a further reconstruction.
        to: name of a format; ``twinct.recon.volume_formats`` has all of them.
        values: attenuation in 1/mm, or HU; None: HU in DICOM if water is known, else attenuation.
        water: attenuation of water and air; None: of a run, the regions of its first entry of
            ``evaluation.hounsfield``, or else the attenuation of water at the effective energy.
        out: file or folder to write, which must not exist; None: ``export-VOLUME`` beside the
            volume.
        observers: notified of the stage.

    Raises:
        InputError: there is no such volume or format, or HU are requested and water is unknown.
        ScanExistsError: the file or folder exists.
        StorageError: the disk is too small or not writable.
    """
    folder = Folder(Path(path))
    file = _file_of(folder, volume)
    out = _free_path(folder, volume, to, out)
    settings = folder.settings_of_scan()
    with audience_of(observers) as audience, audience.stage("export", 1) as step:
        exported = Volume.read(file)
        require_space(out.parent, exported.array.nbytes, "the export needs")
        if values == "attenuation" or (values is None and to != "dicom" and not water):
            water = None
        elif water:
            _check_water(water, exported, audience)
        else:
            water = _water_of(folder, settings, exported, needed=values == "hounsfield")
        if water:
            exported = exported.in_hu(water.water_per_mm, water.air_per_mm)
        facts = VolumeFacts(
            note=f"twinct, {settings.name}, {volume}, {water.in_words if water else '1/mm'}",
            unit="HU" if water else "1/mm",
            scan=settings.name,
            scan_digest=ScanStore(folder.scan).digests["images"],
            kvp=_kvp(settings),
        )
        out.parent.mkdir(parents=True, exist_ok=True)
        exported.write(out, to=to, facts=facts)
        step()
        audience.say(f"values: {water.in_words if water else 'attenuation, 1/mm, no HU'}")
    return out


def _check_water(water: Water, volume: Volume, audience: Audience) -> None:
    """Check that the attenuation of water may be in 1/mm, the unit of a volume."""
    flag = f"--water {water.water_per_mm:g}"
    if water.water_per_mm > MOST_WATER_PER_MM:
        raise InputError(
            f"{flag}: must be at most {MOST_WATER_PER_MM:g}, as it is in 1/mm; {flag[8:]}/m are "
            f"{water.water_per_mm / 1000:g}/mm"
        )
    if water.water_per_mm > (most := float(volume.array.max())):
        audience.say(f"{flag}: no voxel attenuates as much ({most:.4g}/mm at most)", warning=True)


def _free_path(folder: Folder, volume: str, to: str, out: str | Path | None) -> Path:
    """Return where a volume may be written in a format."""
    form = volume_format_named(to)
    ending = form.endings[0] or f"-{form.name}"
    path = folder.path / f"export-{volume}{ending}" if out is None else Path(out)
    refuse_result(path)
    if path.exists():
        raise ScanExistsError(f"{path} exists already: choose another --out")
    if not any(path.name.lower().endswith(end) for end in form.endings):
        raise InputError(f"--out {path}: {form.title} needs a name in {', '.join(form.endings)}")
    return path


def volume_files(folder: Folder) -> dict[str, Path]:
    """Return the files of all volumes in a folder by name."""
    own = {OWN_VOLUME: folder.volume, TRUTH: folder.truth}
    further = {path.parent.name: path for path in folder.reconstructions.glob("[!.]*/volume.nii")}
    return {name: path for name, path in (own | further).items() if path.is_file()}


def _file_of(folder: Folder, volume: str) -> Path:
    if not folder.scenario.is_file() or not folder.scan.is_dir():
        raise InputError(
            f"{folder.path} is no folder of a run; expected scenario.yaml and scan.zarr"
        )
    known = volume_files(folder)
    if volume not in known:
        there = f"choose from {', '.join(sorted(known))}" if known else "the folder holds none yet"
        raise InputError(f"--volume {quoted(volume)}: unknown; {there}")
    return known[volume]


def _water_of(
    folder: Folder, settings: ScanSettings, volume: Volume, *, needed: bool
) -> Water | None:
    """Return water and air of a volume; None if the object and its beam are not known.

    Raises:
        InputError: they are ``needed``, and unknown.
    """
    if settings.specimen is None or settings.source is None:
        if needed:
            raise InputError(
                "--values hounsfield: the attenuation of water in a measured scan is unknown; "
                "state --water and --air in 1/mm, as regions of the volume have them"
            )
        return None
    energy = effective_energy_kev(settings.source, settings.detector)
    attenuations = {"water": material("water").mu_per_mm(energy), "air": 0.0}
    stated = settings.evaluation.entries("hounsfield") if settings.evaluation else ()
    regions = {name: getattr(one, name) for one in stated[:1] for name in attenuations}
    if any(regions.values()):
        scan = load_scan(folder.path)
        scenario, stands = scan.scenario, scan.stands
        places = Places(scenario, SimulationBuilder(scenario).specimen, stands, volume.grid)
        for name, region in regions.items():
            if region:
                attenuations[name] = float(places.region(region).of(volume.array).mean())
    return Water(attenuations["water"], attenuations["air"])


def _kvp(settings: ScanSettings) -> float | None:
    tube = settings.source.spectrum if settings.source else None
    return tube.kvp if isinstance(tube, sections.TubeSpectrum) else None
