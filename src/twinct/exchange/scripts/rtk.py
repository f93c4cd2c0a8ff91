"""Load this folder into RTK (pip install itk-rtk), and reconstruct it with RTK's SART."""
# pyright: reportMissingImports=false, reportAttributeAccessIssue=false

import argparse
import json
from pathlib import Path

import itk
import numpy as np
from itk import RTK

HERE = Path(__file__).resolve().parent
IMAGE = itk.Image[itk.F, 3]


def geometry():
    """Return the geometry of all views."""
    reader = RTK.ThreeDCircularProjectionGeometryXMLFileReader.New()
    reader.SetFilename(str(HERE / "geometry.xml"))
    reader.GenerateOutputInformation()
    return reader.GetOutputObject()


def projections():
    """Return the stack of images: column, row, view."""
    return itk.imread(str(HERE / "projections.mha"), itk.F)


def volume():
    """Return the voxels to reconstruct, all zero."""
    facts = json.loads((HERE / "export.json").read_text())["volume"]
    size, voxel = facts["shape_z_y_x"][::-1], facts["voxel_x_y_z_mm"]
    source = RTK.ConstantImageSource[IMAGE].New()
    source.SetOrigin([-(n - 1) / 2 * edge for n, edge in zip(size, voxel)])
    source.SetSpacing(voxel)
    source.SetSize(size)
    source.SetConstant(0.0)
    source.Update()
    return source.GetOutput()


def reconstruct(iterations, relaxation=0.3):
    """Reconstruct with SART, one view per update, in RTK's random order; return (z, y, x)."""
    sart = RTK.SARTConeBeamReconstructionFilter[IMAGE, IMAGE].New()
    sart.SetInput(0, volume())
    sart.SetInput(1, projections())
    sart.SetGeometry(geometry())
    sart.SetNumberOfIterations(iterations)
    sart.SetNumberOfProjectionsPerSubset(1)
    sart.SetLambda(relaxation)
    # RTK's weights for a shifted panel assume a circular orbit.
    sart.SetDisableDisplacedDetectorFilter(True)
    sart.Update()
    return itk.array_from_image(sart.GetOutput())


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--iterations", type=int, default=0, help="iterations to reconstruct; 0 only loads"
    )
    parser.add_argument("--out", type=Path, default=Path("volume.npy"))
    options = parser.parse_args()
    print(f"{len(geometry().GetGantryAngles())} views, images {projections().shape}")
    if options.iterations:
        np.save(options.out, reconstruct(options.iterations))
        print(f"wrote {options.out}")
