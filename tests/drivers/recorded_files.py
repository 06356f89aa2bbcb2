"""Writers of the formats that recorded scans come in: from a synthetic scan to the bytes that a vendor would write."""

from pathlib import Path

import laspy
import numpy as np
import open3d as o3d
import pye57

from perception import transforms
from perception.scan import BeamPattern, Scan
from tests.synthetic import Scene, box

PATTERN = BeamPattern.with_step(np.deg2rad(2.0), (np.deg2rad(-40), np.deg2rad(60)), (0.5, 120.0))
POSE = transforms.from_euler(0.02, -0.03, 0.7, (12.5, -3.25, 1.5))
"""Where the scans say that they were taken."""


def room() -> Scene:
    """A room without a ceiling over half of it: some beams return nothing."""
    corners = (
        ((-4, -3, -1.5), (4, 3, -1.3)), ((-4, -3, 1.5), (0, 3, 1.7)), ((-4.2, -3, -1.5), (-4, 3, 1.7)),
        ((4, -3, -1.5), (4.2, 3, 1.7)), ((-4, -3.2, -1.5), (4, -3, 1.7)), ((-4, 3, -1.5), (4, 3.2, 1.7)),
    )  # fmt: skip
    return Scene(*(box(*pair) for pair in corners))


def scan_of_a_room(pattern: BeamPattern = PATTERN) -> Scan:
    return room().take(np.eye(4), pattern)


def write_ply(path: Path, scan: Scan, ascii: bool = False) -> None:
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(scan.points.astype(np.float64)))
    o3d.io.write_point_cloud(str(path), cloud, write_ascii=ascii)


def write_pcd(path: Path, scan: Scan, ascii: bool = False, compressed: bool = False) -> None:
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(scan.points.astype(np.float64)))
    o3d.io.write_point_cloud(str(path), cloud, write_ascii=ascii, compressed=compressed)


def write_organised_pcd(path: Path, scan: Scan) -> None:
    """Every beam in its row and column, NaN where nothing returned, with the viewpoint."""
    grid = _grid(scan, np.nan)
    x, y, z, w = transforms.to_quaternion(POSE)
    tx, ty, tz = POSE[:3, 3]
    header = (
        "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z intensity\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 1 1 1 1\n"
        f"WIDTH {scan.pattern.columns}\nHEIGHT {scan.pattern.rows}\n"
        f"VIEWPOINT {tx} {ty} {tz} {w} {x} {y} {z}\nPOINTS {scan.pattern.size}\nDATA binary\n"
    )
    rows = np.column_stack([grid.reshape(-1, 3), np.ones(scan.pattern.size)]).astype("<f4")
    path.write_bytes(header.encode() + rows.tobytes())


def write_e57(path: Path, scan: Scan, times: int = 1) -> None:
    x, y, z, w = transforms.to_quaternion(POSE)
    points = scan.points.astype(np.float64)
    data = dict(zip(("cartesianX", "cartesianY", "cartesianZ"), points.T, strict=True)) | {
        "intensity": scan.intensity,
        "rowIndex": (scan.beam // scan.pattern.columns).astype(np.uint16),
        "columnIndex": (scan.beam % scan.pattern.columns).astype(np.uint16),
    }
    with pye57.E57(str(path), mode="w") as image:
        for number in range(times):
            image.write_scan_raw(
                data, name=f"hall {number}", rotation=np.array([w, x, y, z]), translation=POSE[:3, 3] + (number, 0, 0)
            )


def write_ptx(path: Path, scan: Scan, times: int = 1) -> None:
    """Column after column, downwards, clockwise: as Leica's scanners turn."""
    grid = _grid(scan, 0.0)[::-1, ::-1]
    pose = np.vstack([POSE[:3, 3], POSE[:3, :3].T])
    lines = []
    for _ in range(times):
        lines += [str(scan.pattern.columns), str(scan.pattern.rows)]
        lines += [" ".join(f"{v:.9f}" for v in row) for row in (*pose, *POSE.T)]
        lines += [f"{x:.6f} {y:.6f} {z:.6f} 0.5" for x, y, z in grid.transpose(1, 0, 2).reshape(-1, 3)]
    path.write_text("\n".join(lines) + "\n")


def write_las(path: Path, scan: Scan, offset: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> None:
    header = laspy.LasHeader(point_format=3, version="1.4")
    header.scales, header.offsets = np.full(3, 0.0005), np.asarray(offset)
    cloud = laspy.LasData(header)
    cloud.x, cloud.y, cloud.z = (scan.points.astype(np.float64) + offset).T
    cloud.write(str(path))


def write_3dtk(path: Path, scan: Scan) -> None:
    """Right-handed metres as 3DTK's left-handed centimetres: x right, y up, z forward."""
    change = np.array([[0.0, -1, 0], [0, 0, 1], [1, 0, 0]])
    np.savetxt(path, 100 * scan.points @ change.T, fmt="%.4f")
    turn = change @ POSE[:3, :3] @ change.T
    angles = [np.arctan2(-turn[1, 2], turn[2, 2]), np.arcsin(turn[0, 2]), np.arctan2(-turn[0, 1], turn[0, 0])]
    np.savetxt(path.with_suffix(".pose"), [100 * change @ POSE[:3, 3], np.rad2deg(angles)], fmt="%.9f")


def write_xyz(path: Path, scan: Scan) -> None:
    np.savetxt(path, scan.points, fmt="%.6f")


def write_csv(path: Path, scan: Scan) -> None:
    """With rows and columns, in millimetres, the axes in an order of their own."""
    row, column = np.divmod(scan.beam, scan.pattern.columns)
    x, y, z = 1000.0 * scan.points.T
    np.savetxt(
        path, np.column_stack([row, column, z, x, y]), fmt="%.4f", delimiter=",",
        header="row,col,z_mm,x_mm,y_mm", comments="",
    )  # fmt: skip


def _grid(scan: Scan, missing: float) -> np.ndarray:
    grid = np.full((scan.pattern.size, 3), missing)
    grid[scan.beam] = scan.points
    return grid.reshape(scan.pattern.rows, scan.pattern.columns, 3)


WRITERS = {
    "scan.ply": write_ply,
    "ascii.ply": lambda path, scan: write_ply(path, scan, ascii=True),
    "ascii.pcd": lambda path, scan: write_pcd(path, scan, ascii=True),
    "binary.pcd": write_pcd,
    "compressed.pcd": lambda path, scan: write_pcd(path, scan, compressed=True),
    "organised.pcd": write_organised_pcd,
    "scan.e57": write_e57,
    "scan.ptx": write_ptx,
    "scan.las": write_las,
    "scan.laz": write_las,
    "scan.3d": write_3dtk,
    "scan.xyz": write_xyz,
    "scan.csv": write_csv,
}
WITH_POSE = {"organised.pcd", "scan.e57", "scan.ptx", "scan.3d"}
WITH_BEAMS = {"organised.pcd", "scan.e57", "scan.ptx", "scan.csv"}
