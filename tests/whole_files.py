"""Whole files of every format that is read: ordinary ones, to be damaged, and absurd ones."""

import io
import json
import zipfile
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from motionrecover.io import load, save, save_skeleton
from motionrecover.motion import Motion
from motionrecover.skeleton import Skeleton
from motionrecover.synthetic import synthesize

NAMES = ("root", "lfemur", "ltibia", "rfemur", "rtibia")


@dataclass(frozen=True)
class Case:
    """A whole file, and how to load it."""

    name: str
    content: bytes
    """The file to damage."""
    beside: dict[str, bytes] = field(default_factory=dict)
    """Other files of its folder."""
    path: str | None = None
    """The file to load, where that is another one."""
    asked: dict = field(default_factory=dict)
    """Arguments of `load`; the value of `skeleton` is a name in the folder."""

    def size(self, content: bytes) -> int:
        """Bytes of all files, where the damaged one holds `content`."""
        return sum(map(len, [content, *self.beside.values()]))


def cases(folder: Path, frames: int = 5) -> dict[str, list[Case]]:
    """Whole files of every format that is read, with `frames` frames, written in `folder`."""
    whole = synthesize(1.0, 120.0).select(NAMES)
    some = np.arange(frames) % len(whole)
    gap = np.where((some == 1)[:, None, None], np.nan, whole.positions[some]).round(4)
    clip = Motion(whole.positions[some].round(4), whole.skeleton, 120.0, history=("made",))
    rest = np.vstack([np.zeros(3), np.diff(clip.positions[0], axis=0)])
    trust = Motion(
        gap.astype(np.float32),
        Skeleton(whole.names, whole.skeleton.edges, rest),
        120.0,
        confidence=np.where(np.isnan(gap[..., 0]), np.nan, 0.5),
    )

    def saved(motion, name, **asked):
        content = save(motion, folder / name, overwrite=True, **asked).read_bytes()
        return Case(name, content, asked=asked)

    found = {
        "bvh": [saved(clip, "clip.bvh"), saved(load(folder / "clip.bvh", unit="m"), "clip.bvh")],
        "c3d": [saved(clip, "clip.c3d"), saved(trust, "clip.c3d")],
        "trc": [saved(clip, "clip.trc"), saved(trust, "clip.trc")],
        "csv": [saved(clip, "clip.csv"), saved(trust, "clip.csv")],
        "csv-long": [saved(clip, "clip.csv", format="csv-long"), saved(trust, "clip.csv", format="csv-long")],
        "npz": [saved(clip, "clip.npz"), saved(trust, "clip.npz"), _graph_npz(trust)],
        "amc": _acclaim(frames),
        "kinect": [_kinect(frames)],
        "freemocap": _freemocap(frames),
    }
    array = found["npz"][0]
    tree = save_skeleton(whole.skeleton, folder / "bones.toml", overwrite=True).read_bytes()
    parents = f"names = {json.dumps(NAMES)}\nparents = {list(whole.skeleton.parents)}\n".encode()
    found["toml"] = [
        Case("bones.toml", content, {array.name: array.content}, array.name, {"skeleton": "bones.toml"})
        for content in (tree, parents)
    ]
    return found


def _graph_npz(motion: Motion) -> Case:
    """An NPZ file without rate, in centimetres with z up, on a graph that is no tree."""
    packed = io.BytesIO()
    np.savez(
        packed,
        positions=motion.positions * 100,
        names=np.array(NAMES),
        edges=np.array([[0, 1], [1, 2], [2, 0]]),
        unit=np.array(0.01),
        up=np.array("z"),
    )
    return Case("clip.npz", packed.getvalue(), asked={"fps": 30})


def _acclaim(frames: int) -> list[Case]:
    bones = "".join(
        f"  begin\n    id {k}\n    name {name}\n    direction 0.6 -0.8 0\n    length {k}\n    axis 10 20 30 XYZ\n"
        f"    dof rx rz\n    limits (-10 10)\n           (-20 20)\n  end\n"
        for k, name in enumerate(NAMES[1:], 1)
    )
    asf = (
        "# made up\n:version 1.10\n:name TEST\n:units\n  mass 1.0\n  length 0.45\n  angle deg\n:documentation\n  none\n"
        ":root\n  order TX TY TZ RX RY RZ\n  axis XYZ\n  position 0 0 0\n  orientation 0 0 0\n"
        f":bonedata\n{bones}:hierarchy\n  begin\n    root lfemur rfemur\n    lfemur ltibia\n"
        "    rfemur rtibia\n  end\n"
    ).encode()
    rows = "".join(
        f"{k}\nroot 1.5 2 3 40 50 {k}\n" + "".join(f"{name} {k}.5 -3\n" for name in NAMES[1:])
        for k in range(1, frames + 1)
    )
    amc = f"#made up\n:FULLY-SPECIFIED\n:DEGREES\n{rows}".encode()
    return [Case("clip.amc", amc, {"bones.asf": asf}), Case("bones.asf", asf, {"clip.amc": amc}, "clip.amc")]


def _kinect(frames: int) -> Case:
    samples = np.random.default_rng(0).uniform(-2, 2, (frames, 25, 3)).round(6)
    lines = [
        f"{10**11 + 333_333 * k}," + ",".join(f"{x},{y},{z},{k % 3}" for x, y, z in frame) + ",\n"
        for k, frame in enumerate(samples.tolist())
    ]
    return Case("take.csv", "".join(lines).encode())


def _freemocap(frames: int) -> list[Case]:
    rng = np.random.default_rng(0)

    def stored(array):
        file = io.BytesIO()
        np.save(file, array)
        return file.getvalue()

    name, listed = "mediapipe_body_3d_xyz.npy", "mediapipe_names_and_connections_dict.json"
    body = stored(rng.normal(scale=500, size=(frames, 5, 3)))
    errors = {"mediapipe_3dData_numFrames_numTrackedPoints_reprojectionError.npy": stored(rng.random((frames, 5)))}
    names = {listed: json.dumps({"body": {"names": NAMES, "connections": []}}).encode()}
    asked = {"fps": 30}
    return [
        Case(name, body, names | errors, asked=asked),
        Case(listed, names[listed], {name: body}, name, asked),
        Case(next(iter(errors)), errors[next(iter(errors))], names | {name: body}, name, asked),
    ]


def absurd() -> dict[str, Case]:
    """Files of 100 kB and more that ask for memory and time without end, by what is absurd about them."""

    def bvh(hierarchy: str, row: str, rows: int) -> Case:
        head = f"HIERARCHY\n{hierarchy}\nMOTION\nFrames: {rows}\nFrame Time: 0.01\n"
        return Case("clip.bvh", (head + f"{row}\n" * rows).encode())

    six = "CHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation Xrotation"
    root, end = f"ROOT a {{ OFFSET 0 0 0\n{six}", "End Site { OFFSET 0 1 0 }\n"
    three = "{ OFFSET 0 1 0\nCHANNELS 3 Zrotation Yrotation Xrotation\n"
    chain = "".join(f"\nJOINT j{k} {three}" for k in range(4000))
    csv = "# fps: 100\n# unit: m\n"
    wide = ",".join(f"j{k}_{axis}" for k in range(3000) for axis in "xyz")
    few = ",".join(f"j{k}_{axis}" for k in range(10) for axis in "xyz")
    sparse = "".join(f"{k},j{k % 1500},1,2,3\n" for k in range(15_000))
    trc = "PathFileType\t4\t(X/Y/Z)\ta.trc\nDataRate\tNumFrames\tNumMarkers\tUnits\n100\t9\t3000\tmm\nFrame#\tTime\t"
    trc += "\t\t\t".join(f"m{k}" for k in range(3000)) + "\t\t\n\t\t" + "\t".join(["X\tY\tZ"] * 3000) + "\n"
    asf, amc = _acclaim(1)[1].content.decode(), "#\n:DEGREES\n"
    bones = "".join(
        f"  begin\n    name b{k}\n    direction 1 0 0\n    length 1\n    axis 0 0 0 XYZ\n  end\n" for k in range(2000)
    )
    still = f"{asf[: asf.index(':bonedata')]}:bonedata\n{bones}:hierarchy\n  begin\n"
    still += "    root b0\n" + "".join(f"    b{k} b{k + 1}\n" for k in range(1999)) + "  end\n"
    line = _kinect(1).content.decode().split(",", 1)[1]
    kinect = "".join(f"{333_333 * (k + 9 * k * (k % 2))},{line}" for k in range(100))
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as file:
        for name, array in {"positions": np.zeros((3_000_000, 5, 3)), "names": np.array(NAMES)}.items():
            with file.open(f"{name}.npy", "w") as member:
                np.save(member, array)
    blank = b"\x93NUMPY\x01\x00\x76\x00"
    no_size = blank + b"{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000, 0, 3), }".ljust(118)
    return {
        "bvh: deep": bvh(f"{root}{chain}{end}{'}' * 4001}", "0 " * 12_006, 9),
        "bvh: wide": bvh(f"{root}\n{end * 5000}}}", "0 0 0 0 0 0", 9),
        "bvh: end sites": bvh(f"{root}\n{end * 500}}}", "0 0 0 0 0 0", 9000),
        "bvh: zeros": bvh(f"{root}\nJOINT b {three}{end}}}}}", "0 0 0 0 0 0 0 0 0", 9000),
        "bvh: row": bvh(f"{root}\n{end}}}", "0 " * 200_000, 1),
        "csv: wide": Case("clip.csv", (csv + wide + ("\n" + "1," * 8999 + "1") * 7 + "\n").encode()),
        "csv: empty": Case("clip.csv", (csv + few + ("\n" + "," * 29) * 9000 + "\n").encode()),
        "csv: digits": Case("clip.csv", (csv + few + ("\n" + "1," * 29 + "1") * 9000 + "\n").encode()),
        "csv: comments": Case("clip.csv", (csv + "# \n" * 60_000 + few).encode()),
        "csv: lines": Case("clip.csv", (csv + "a_x,a_y,a_z\n" + "1\n" * 60_000).encode()),
        "csv: quote": Case("clip.csv", (csv + 'a_x,a_y,a_z\n"' + "1,1,1\n" * 60_000).encode()),
        "csv-long: sparse": Case("clip.csv", (csv + "frame,joint,x,y,z\n" + sparse).encode()),
        "csv-long: nests": Case("clip.csv", (csv + "# bones: " + "[" * 200_000 + "\n" + few + "\n").encode()),
        "trc: wide": Case("clip.trc", (trc + ("1\t2" + "\t1" * 9000 + "\n") * 9).encode()),
        "trc: empty": Case("clip.trc", (trc + "".join(f"{k}\t\n" for k in range(20_000))).encode()),
        "amc: still": Case(
            "clip.amc",
            (amc + "".join(f"{k}\nroot 0 0 0 0 0 0\n" for k in range(5000))).encode(),
            {"bones.asf": still.encode()},
        ),
        "kinect: pauses": Case("take.csv", kinect.encode()),
        "npz: zeros": Case("clip.npz", packed.getvalue(), asked={"fps": 30}),
        "freemocap: no size": Case("mediapipe.npy", no_size, asked={"fps": 30}),
        "toml: deep": Case(
            "bones.toml", b"names = " + b"[" * 100_000, _one_joint(), "clip.npz", {"skeleton": "bones.toml"}
        ),
    }


def _one_joint() -> dict[str, bytes]:
    packed = io.BytesIO()
    np.savez(packed, positions=np.zeros((1, 1, 3)), names=np.array(["a"]), fps=np.array(30.0))
    return {"clip.npz": packed.getvalue()}
