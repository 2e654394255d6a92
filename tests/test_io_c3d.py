"""C3D against ezc3d, against files composed byte by byte, and against what must stay as it was."""

import struct
from dataclasses import replace

import ezc3d
import numpy as np
import pytest

from motionrecover.cli import main
from motionrecover.io import MotionFormatWarning, load, save
from motionrecover.motion import Motion
from motionrecover.skeleton import Skeleton

pytestmark = pytest.mark.filterwarnings("ignore:.*without bones:motionrecover.io.MotionFormatWarning")

LABELS = ["LASI", "RASI", "*110"]
CODES = {"intel": (84, "<"), "dec": (85, "<"), "sgi": (86, ">")}
TEXTS = {"UNITS": ["mm"], "X_SCREEN": ["+X"], "Y_SCREEN": ["+Z"]}


def real(value, code):
    """Four bytes of a float; DEC's by their definition: sign, excess-128 exponent of 0.1f, 23 bits, halves swapped."""
    if code != "dec":
        return struct.pack(CODES[code][1] + "f", value)
    if value == 0:
        return bytes(4)
    mantissa, exponent = np.frexp(abs(value))
    bits = (value < 0) << 31 | (int(exponent) + 128) << 23 | round(float(mantissa) * 2**24) - 2**23
    return struct.pack("<HH", bits >> 16, bits & 0xFFFF)


def composed(
    steps,
    words,
    code="intel",
    scale=-1.0,
    analog=(),
    texts=TEXTS,
    labels=LABELS,
    numbers=None,
    header=None,
    rotations=0,
):
    """A C3D file of steps (frame, point, 3) of the scale, fourth numbers (frame, point) and analog (frame, channel)."""
    frames, points = words.shape
    processor, order = CODES[code]
    analog = np.zeros((frames, 0)) if len(analog) == 0 else np.asarray(analog)
    short, floating = (lambda n: struct.pack(f"{order}H", int(n) % 65536)), scale < 0

    def record(name, number, kind=None, dims=(), raw=b""):
        body = b"" if kind is None else bytes([kind % 256, len(dims), *dims]) + raw
        return bytes([len(name), number % 256]) + name.encode() + short(len(body) + 3) + body + b"\0"

    stated = {"USED": short(points), "SCALE": real(scale, code), "RATE": real(100.0, code)} | (numbers or {})
    records = record("POINT", -1)
    for name, raw in stated.items():
        records += record(name, 1, len(raw), (), raw)
    for name, lines in {"LABELS": labels, **texts}.items():
        width = max(map(len, lines), default=0)
        records += record(name, 1, -1, (width, len(lines)), b"".join(line.ljust(width).encode() for line in lines))
    records += record("ANALOG", -2) + record("USED", 2, 2, (), short(analog.shape[1]))
    channels = analog.shape[1]
    records += record("RATE", 2, 4, (), real(100.0, code)) + record("GEN_SCALE", 2, 4, (), real(1.0, code))
    records += record("SCALE", 2, 4, (channels,), real(1.0, code) * channels)
    records += record("OFFSET", 2, 2, (channels,), bytes(2 * channels))
    records += record("LABELS", 2, -1, (1, channels), b"A" * channels)
    if rotations:
        records += record("ROTATION", -3) + record("USED", 3, 2, (), short(rotations))
    blocks = -(-(len(records) + 6) // 512)
    parameters = (bytes([1, 0x50, blocks, processor]) + records).ljust(512 * blocks, b"\0")
    fields = {"points": points, "analog": analog.shape[1], "first": 11, "last": 10 + frames, "gap": 10}
    top = bytes([2, 0x50]) + b"".join(short(n) for n in (fields | (header or {})).values()) + real(scale, code)
    top += short(2 + blocks) + short(min(1, analog.shape[1])) + real(100.0, code)
    number = (lambda value: real(value, code)) if floating else short
    data = b""
    for frame in range(frames):
        samples = np.concatenate([steps[frame], words[frame][:, None]], 1).ravel()
        data += b"".join(number(value) for value in [*samples, *analog[frame]])
    return top.ljust(512, b"\0") + parameters + data


def steps_and_words(frames=4):
    rng = np.random.default_rng(0)
    words = rng.integers(1, 2**7, (frames, 3)) * 256 + rng.integers(1, 255, (frames, 3))
    words[1, 2] = -1
    words[2, 0] = 0x0300
    return rng.integers(-9999, 9999, (frames, 3, 3)), words


def put(folder, content, name="clip.c3d"):
    path = folder / name
    path.write_bytes(content)
    return path


def held(path):
    """What ezc3d finds: points (frame, point, 3), residuals (which it takes for cameras), analog data, parameters."""
    file = ezc3d.c3d(str(path))
    data = file["data"]
    points = data["points"][:3].transpose(2, 1, 0)
    parameters = {
        f"{group}:{name}": (value["type"], value["description"], np.array(value["value"]).tolist())
        for group, members in file["parameters"].items()
        for name, value in members.items()
        if name != "__METADATA__"
    }
    header = {part: dict(file["header"][part].items()) for part in ("points", "analogs")}
    return points, data["meta_points"]["residuals"][0].T, data["analogs"], parameters, header


@pytest.mark.parametrize("scale", [-0.5, 0.5])
@pytest.mark.parametrize("code", CODES)
def test_every_number_format_is_read_as_ezc3d_does_and_written_back(tmp_path, code, scale):
    steps, words = steps_and_words()
    path = put(tmp_path, composed(steps, words, code, scale, np.arange(8).reshape(4, 2)))
    motion = load(path)
    step = 1.0 if scale < 0 else scale
    x, y, z = np.moveaxis(np.where(words[..., None] < 0, np.nan, steps * step / 1000), -1, 0)
    np.testing.assert_allclose(motion.positions, np.stack([x, z, -y], -1))
    assert (motion.fps, motion.unit, motion.up, motion.names) == (100, 0.001, "z", tuple(LABELS))
    if code != "sgi":  # which ezc3d does not read
        points, residuals, *_ = held(path)
        np.testing.assert_allclose(points[motion.observed] / 1000, np.stack([x, y, z], -1)[motion.observed])
        np.testing.assert_array_equal(residuals < 0, ~motion.observed)

    assert save(motion, tmp_path / "same.c3d").read_bytes() == path.read_bytes()
    moved = motion.positions.copy()
    moved[1, 2] = [0.1, 0.2, -0.3]
    moved[2, 1] += 0.01
    moved[3, 0] = np.nan
    back = save(motion.with_positions(moved, "moved"), tmp_path / "moved.c3d")
    steps, words = steps.copy(), words.copy()
    for frame, point in ((1, 2), (2, 1)):
        x, y, z = moved[frame, point] * 1000
        steps[frame, point] = np.rint(np.array([x, -z, y]) / step)
    steps[3, 0] = 0
    words[1, 2], words[2, 1], words[3, 0] = 0, 0, -1
    assert back.read_bytes() == composed(steps, words, code, scale, np.arange(8).reshape(4, 2))


def test_residuals_and_cameras_say_what_was_measured_and_how_well(tmp_path):
    steps, words = steps_and_words()
    words = np.array([[0x3F11, 0x3F22, 0x3F01], [0x3FFF, 0x7F01, -1], [0, 0x0F01, 0x0301], [0x0001, 0x1F01, 0x3F01]])
    motion = load(put(tmp_path, composed(steps, words)))
    np.testing.assert_array_equal(motion.observed, words >= 0)
    # Six cameras are usual; a sample without residual was computed; one without cameras has no others to be less than.
    expected = np.array([[1, 1, 1], [1, 1, 0.5], [0.5, (4 / 6) ** 2, (2 / 6) ** 2], [1, (5 / 6) ** 2, 1]])
    np.testing.assert_allclose(motion.confidence, expected)
    assert load(put(tmp_path, composed(steps, words & 0x7F00))).confidence is None


def test_coordinates_that_are_no_number_are_missing_and_stay(tmp_path):
    steps, words = steps_and_words()
    steps = steps.astype(float)
    steps[0, 0, 1] = np.nan
    path = put(tmp_path, composed(steps, words))
    assert not load(path).observed[0, 0]
    assert save(load(path), tmp_path / "same.c3d").read_bytes() == path.read_bytes()


def test_points_that_are_left_out_stay_as_they_came(tmp_path):
    steps, words = steps_and_words()
    path = put(tmp_path, composed(steps, words, texts=TEXTS | {"ANGLES": ["RASI"]}))
    motion = load(path)
    assert motion.names == ("LASI", "*110")
    assert "left 1 point out that are no positions" in motion.history
    one = motion.select(["*110"])
    back = save(one.with_positions(one.positions + 0.001, "moved"), tmp_path / "back.c3d")
    (before, *_), (after, *_) = held(path), held(back)
    np.testing.assert_array_equal(before[:, :2], after[:, :2])
    assert not np.isclose(before[0, 2], after[0, 2]).any()


def test_skip_first_leaves_a_frame_of_everything_out(tmp_path, refused):
    rng = np.random.default_rng(0)
    file = ezc3d.c3d()
    file["parameters"]["POINT"]["RATE"]["value"] = [100.0]
    file["parameters"]["POINT"]["UNITS"]["value"] = ["mm"]
    file["parameters"]["POINT"]["LABELS"]["value"] = LABELS
    file["parameters"]["ANALOG"]["RATE"]["value"] = [200.0]
    file["parameters"]["ANALOG"]["LABELS"]["value"] = ["EMG"]
    file["data"]["points"] = np.concatenate([rng.normal(size=(3, 3, 5)), np.ones((1, 3, 5))])
    file["data"]["analogs"] = rng.normal(size=(1, 1, 10))
    file.add_parameter("TRIAL", "ACTUAL_START_FIELD", [7, 1])
    file.add_parameter("TRIAL", "ACTUAL_END_FIELD", [11, 1])
    file.add_event((0.0, 0.01), "Left", "Foot Strike")
    file.write(str(tmp_path / "clip.c3d"))
    motion = load(tmp_path / "clip.c3d", skip_first=True, up="z")
    path = save(motion, tmp_path / "rest.c3d")
    (points, _, analogs, parameters, header), rest = held(tmp_path / "clip.c3d"), held(path)
    np.testing.assert_array_equal(rest[0], points[1:])
    np.testing.assert_array_equal(rest[2], analogs[..., 2:])
    changes = {name: rest[3][name][2] for name in parameters if rest[3][name] != parameters[name]}
    assert changes == {"POINT:FRAMES": [4], "TRIAL:ACTUAL_START_FIELD": [8, 1]}
    assert rest[4]["points"]["last_frame"] == header["points"]["last_frame"]
    assert rest[4]["points"]["first_frame"] == header["points"]["first_frame"] + 1
    np.testing.assert_array_equal(load(path, up="z").positions, motion.positions)

    cut = replace(motion, positions=motion.positions[1:], observed=None)
    refused(lambda: save(cut, tmp_path / "cut.c3d"), "3 frames", "4 frames", "source.frames")
    assert motion.source is not None
    save(replace(cut, source=motion.source.frames(slice(1, None))), tmp_path / "cut.c3d")
    named = replace(motion, skeleton=Skeleton(["a", *motion.names[1:]]))
    refused(lambda: save(named, tmp_path / "named.c3d"), "'a'", "source=None")


def test_rotations_have_frames_that_cannot_be_left_out(tmp_path, refused):
    path = put(tmp_path, composed(*steps_and_words(), rotations=1))
    assert save(load(path), tmp_path / "same.c3d").read_bytes() == path.read_bytes()
    refused(lambda: save(load(path, skip_first=True), tmp_path / "rest.c3d"), "rotations", "write all")


def test_a_clip_from_elsewhere_makes_a_file_that_ezc3d_reads(tmp_path, refused):
    positions = np.random.default_rng(0).normal(size=(6, 300, 3))
    positions[2, 5] = np.nan
    motion = Motion(positions, Skeleton([f"marker {k}" for k in range(300)]), 59.94)
    path = save(motion, tmp_path / "made.c3d")
    points, residuals, analogs, parameters, header = held(path)
    np.testing.assert_allclose(
        points, 1000 * np.stack([positions[..., 0], -positions[..., 2], positions[..., 1]], -1), 1e-6
    )
    np.testing.assert_array_equal(residuals, np.where(np.isnan(positions[..., 0]), -1, 0))
    assert analogs.size == 0
    assert parameters["POINT:UNITS"][2] == ["mm"]
    assert parameters["POINT:Y_SCREEN"][2] == ["+Z"]
    assert header["points"]["frame_rate"] == pytest.approx(59.94)
    again = load(path)
    np.testing.assert_allclose(again.positions, positions, rtol=1e-6)
    assert (again.names, again.fps) == (motion.names, pytest.approx(59.94))

    named = replace(motion, skeleton=Skeleton(["left ", *motion.names[1:]]))
    refused(lambda: save(named, tmp_path / "named.c3d"), "'left '", "spaces")
    long = replace(motion, skeleton=Skeleton(["x" * 256, *motion.names[1:]]))
    refused(lambda: save(long, tmp_path / "long.c3d"), "256 bytes")


def test_more_frames_than_a_word_counts(tmp_path):
    positions = np.arange(3.0 * 70_000).reshape(70_000, 1, 3) / 1000
    path = save(Motion(positions, Skeleton(["hip"]), 100), tmp_path / "long.c3d")
    np.testing.assert_allclose(load(path).positions, positions, rtol=1e-6)
    assert len(held(path)[0]) == 70_000
    rest = load(path, skip_first=True)
    assert len(load(save(rest, tmp_path / "rest.c3d"))) == 69_999
    assert rest.source is not None
    end = replace(
        rest, positions=rest.positions[-10_000:], observed=None, source=rest.source.frames(slice(-10_000, None))
    )
    np.testing.assert_array_equal(load(save(end, tmp_path / "end.c3d")).positions, end.positions)


def test_labels_become_names_of_their_own(tmp_path):
    steps, words = steps_and_words()
    names = load(put(tmp_path, composed(steps, words, labels=["Ann:LASI", "Ann:LASI"]))).names
    assert names == ("Ann:LASI", "Ann:LASI 2", "point 3")
    texts = TEXTS | {"LABELS2": ["*110", ""]}
    assert load(put(tmp_path, composed(steps, words, labels=["LASI"], texts=texts))).names == (
        "LASI",
        "*110",
        "point 3",
    )


def test_what_the_file_leaves_out_is_assumed_aloud(tmp_path, refused):
    steps, words = steps_and_words()
    path = put(tmp_path, composed(steps, words, texts={}))
    with pytest.warns(MotionFormatWarning) as said:
        motion = load(path)
    assert (motion.unit, motion.up) == (0.001, "z")
    sentences = [str(warning.message) for warning in said]
    assert "clip.c3d states no unit: assumed mm, override with unit= (--unit)" in sentences
    assert "clip.c3d states no up axis: assumed z, override with up= (--up)" in sentences
    assert all(any(sentence in line for line in motion.history) for sentence in sentences)
    assert said[0].filename == __file__
    motion = load(path, unit="cm", up="y", fps=50)
    assert (motion.unit, motion.up, motion.fps) == (0.01, "y", 50)
    assert save(motion, tmp_path / "same.c3d").read_bytes() == path.read_bytes()

    path = put(tmp_path, composed(steps, words, texts={"UNITS": ["Meters"], "Y_SCREEN": ["Y"]}))
    assert (load(path).unit, load(path).up) == (1.0, "y")
    with pytest.warns(MotionFormatWarning, match="'-Z'"):
        load(put(tmp_path, composed(steps, words, texts={"UNITS": ["m"], "Y_SCREEN": ["-Z"]})))
    path = put(tmp_path, composed(steps, words, numbers={"RATE": real(0.0, "intel")}))
    refused(lambda: load(path), "clip.c3d", "frame rate of 0", "--fps")
    assert load(path, fps=30).fps == 30


def test_a_skeleton_may_be_asked_for(tmp_path, refused):
    path = put(tmp_path, composed(*steps_and_words()))
    skeleton = Skeleton(reversed(LABELS), [(0, 1)])
    motion = load(path, skeleton=skeleton)
    assert motion.skeleton == skeleton
    np.testing.assert_array_equal(motion.positions, load(path).positions[:, ::-1])
    assert save(motion, tmp_path / "same.c3d").read_bytes() == path.read_bytes()
    refused(lambda: load(path, skeleton="cmu21"), "clip.c3d", "'LASI'")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"header": {"points": 2}}, ["2 points", "POINT:USED 3"]),
        ({"header": {"last": 15}}, ["5 frames", "holds 4", "whole file"]),
        ({"header": {"last": 5}}, ["0 frames", "nothing to read"]),
        ({"header": {"analog": 9}}, ["84 bytes", "holds 2"]),
        ({"numbers": {"SCALE": real(0.0, "intel")}}, ["scale is 0"]),
        ({"numbers": {"SCALE": real(np.nan, "intel")}}, ["scale is nan"]),
        ({"texts": {"USED": ["xyz"]}}, ["POINT:USED", "text"]),
        ({"texts": TEXTS | {"ANGLES": LABELS}}, ["angles", "no positions"]),
    ],
)
def test_each_defect_is_told_in_one_sentence(tmp_path, refused, changes, words):
    path = put(tmp_path, composed(*steps_and_words(), **changes))
    refused(lambda: load(path), str(path), *words)


def test_what_is_no_whole_file_is_told_in_one_sentence(tmp_path, refused):
    whole = composed(*steps_and_words())
    refused(lambda: load(put(tmp_path, b"BVH" * 999)), "clip.c3d", "no C3D file")
    refused(lambda: load(put(tmp_path, b"")), "clip.c3d", "empty")
    refused(lambda: load(put(tmp_path, whole[:515] + b"\0" + whole[516:])), "clip.c3d", "block 2", "damaged")
    refused(lambda: load(put(tmp_path, whole[:-1])), "clip.c3d", "4 frames", "holds 3", "whole file")
    refused(lambda: load(tmp_path / "none.c3d"), "none.c3d", "does not exist")


def test_integers_end_somewhere(tmp_path, refused):
    motion = load(put(tmp_path, composed(*steps_and_words(), scale=0.1)))
    far = motion.with_positions(motion.positions + 4, "moved")
    refused(lambda: save(far, tmp_path / "far.c3d"), "16-bit", "3276.7", "another format")


@pytest.mark.filterwarnings("ignore::motionrecover.io.MotionFormatWarning")
@pytest.mark.parametrize("name", ["cmu_02_01", "cmu_85_12", "cmu_135_02", "markers_analogs"])
def test_real_files_keep_all_but_the_points(tmp_path, shared_data, name):
    source = shared_data / "markers" / f"{name}.c3d"
    motion = load(source)
    points, residuals, analogs, parameters, header = held(source)
    np.testing.assert_allclose(motion.positions, np.stack([points[..., 0], points[..., 2], -points[..., 1]], -1) / 1000)
    np.testing.assert_array_equal(motion.observed, residuals >= 0)
    assert save(motion, tmp_path / "same.c3d").read_bytes() == source.read_bytes()

    # As recovering does: gaps filled, a part of the samples moved, in 32 bits.
    rng = np.random.default_rng(0)
    move = rng.random(motion.observed.shape) < 0.3
    filled = np.where(motion.observed[..., None], motion.positions, 1.0)
    found = np.where(move[..., None], filled + 0.001, filled).astype(np.float32)
    path = save(motion.with_positions(found, "recovered"), tmp_path / "back.c3d")
    back = held(path)
    np.testing.assert_allclose(back[0], 1000 * np.stack([found[..., 0], -found[..., 2], found[..., 1]], -1), 1e-6, 1e-3)
    np.testing.assert_array_equal(back[1], np.where(move | ~motion.observed, 0, residuals))
    np.testing.assert_array_equal(back[2], analogs)
    assert (back[3], back[4]) == (parameters, header)
    assert path.stat().st_size == source.stat().st_size


def test_the_command_recovers_markers_on_bones_of_their_own(tmp_path, capsys):
    rng = np.random.default_rng(0)
    t = np.linspace(0, 3, 40)[:, None, None]
    x, y, z = rng.normal(scale=200, size=(3, 6))
    body = np.stack(
        [
            np.cos(t[..., 0]) * x - np.sin(t[..., 0]) * y,
            np.sin(t[..., 0]) * x + np.cos(t[..., 0]) * y,
            z + 0 * t[..., 0],
        ],
        -1,
    )
    words = np.zeros((40, 6), int)
    words[10:20, 2] = -1
    labels = [f"M{k}" for k in range(6)]
    path = put(tmp_path, composed(body, words, labels=labels))
    out = tmp_path / "clean.c3d"
    assert main(["recover", str(path), "-o", str(out)]) == 0
    said = capsys.readouterr()
    assert "note: clip.c3d names 6 joints without bones: inferred 14 bones in 1 part" in said.err
    points, residuals, *_ = held(out)
    assert (residuals == 0).all()
    np.testing.assert_allclose(points, body, atol=5)
