"""TRC: the layout of OpenSim with its variants, what is written, and one sentence for each defect."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from motionrecover.io import MotionFormatWarning, load, save
from motionrecover.motion import Motion
from motionrecover.skeleton import Skeleton

pytestmark = pytest.mark.filterwarnings("ignore:.*without bones:motionrecover.io.MotionFormatWarning")

TEXT = """PathFileType\t4\t(X/Y/Z)\twalk.trc
DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames
100.00\t100.00\t3\t2\tmm\t200.00\t1\t99
Frame#\tTime\tR.ASIS\t\t\tL ASIS\t\t
\t\tX1\tY1\tZ1\tX2\tY2\tZ2

7\t0.06\t733.7041\t80.9832\t191.8668\t-651.6759\t1e3\t178.9877
8\t0.07\t\t\t\t1\t2\t3
9\t0.08\t4\t5\tNaN
"""
NAN = np.nan
POSITIONS = np.array(
    [
        [[733.7041, 80.9832, 191.8668], [-651.6759, 1000, 178.9877]],
        [[NAN, NAN, NAN], [1, 2, 3]],
        [[4, 5, NAN], [NAN, NAN, NAN]],
    ]
)


def write(folder, text, name="clip.trc"):
    path = folder / name
    path.write_bytes(text.encode())
    return path


def test_the_layout_of_opensim_is_read(tmp_path):
    motion = load(write(tmp_path, TEXT), up="y")
    np.testing.assert_allclose(motion.positions, POSITIONS / 1000)
    assert motion.observed.tolist() == [[True, True], [False, True], [False, False]]
    assert (motion.fps, motion.unit, motion.names, motion.skeleton.edges) == (100, 0.001, ("R.ASIS", "L ASIS"), ())
    motion = load(write(tmp_path, TEXT.replace("\tmm\t", "\tm\t")), up="z", fps=50)
    np.testing.assert_allclose(motion.positions[0, 0], [733.7041, 191.8668, -80.9832])
    assert (motion.fps, motion.unit, motion.up) == (50, 1, "z")
    skeleton = Skeleton(["L ASIS", "R.ASIS"], [(0, 1)])
    assert load(write(tmp_path, TEXT), up="y", skeleton=skeleton).skeleton == skeleton


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text.replace("\n", "\r\n"),
        lambda text: text.replace("\n", "\t\t\n"),
        lambda text: text.replace("\t", ","),
        lambda text: text.replace("\t", ";").replace(".", ","),
        lambda text: text.replace(".", ",").replace("R,ASIS", "R.ASIS"),
        lambda text: text.replace("Z2\n\n", "Z2\n"),
        lambda text: text.replace("NaN", "\t\t\t"),
        lambda text: text.replace("\t\t\t\t1", "\tnan\t \tNaN\t1"),
        lambda text: "\ufeff" + text.rstrip("\n"),
    ],
)
def test_variants_of_the_layout_are_the_same_clip(tmp_path, change):
    motion = load(write(tmp_path, change(TEXT)), up="y")
    np.testing.assert_allclose(motion.positions, POSITIONS / 1000)
    assert (motion.fps, [name.replace(",", ".") for name in motion.names]) == (100, ["R.ASIS", "L ASIS"])


@pytest.mark.parametrize(
    ("old", "new", "words", "facts"),
    [
        ("\t3\t2\t", "\t3\t2\t", "states no up axis: assumed y, override with up=", (0.001, 3)),
        ("\t3\t2\t", "\t5\t2\t", "states NumFrames '5': took the 3 frames it has", (0.001, 3)),
        ("\t3\t2\t", "\t3\t4\t", "states NumMarkers '4': took the 2 markers it has", (0.001, 3)),
        ("\tmm\t", "\t\t", "states Units '': assumed mm, override with unit=", (0.001, 3)),
        ("\tmm\t", "\tMeters\t", "no up axis", (1.0, 3)),
        ("9\t0.08\t4\t5\tNaN\n", "", "took the 2 frames", (0.001, 2)),
    ],
)
def test_what_the_header_leaves_out_or_gets_wrong_is_assumed_aloud(tmp_path, old, new, words, facts):
    with pytest.warns(MotionFormatWarning) as said:
        motion = load(write(tmp_path, TEXT.replace(old, new)))
    sentences = [str(warning.message) for warning in said]
    assert [sentence for sentence in sentences if words in sentence]
    assert all(any(sentence in line for line in motion.history) for sentence in sentences)
    assert {warning.filename for warning in said} == {__file__}
    assert (motion.unit, len(motion), motion.up) == (*facts, "y")


def test_a_clip_from_elsewhere_is_written_in_millimetres_from_frame_1(tmp_path, refused):
    positions = np.array([[[0.001, -0.002, 1.5], [NAN] * 3], [[0, 0.25, 1 / 3], [1, 2, 3]]])
    path = save(Motion(positions, Skeleton(["hip", "left knee"]), 40), tmp_path / "clip.trc")
    assert path.read_bytes().decode().split("\r\n") == [
        "PathFileType\t4\t(X/Y/Z)\tmotionrecover",
        TEXT.split("\n")[1],
        "40\t40\t2\t2\tmm\t40\t1\t2",
        "Frame#\tTime\thip\t\t\tleft knee\t\t",
        "\t\tX1\tY1\tZ1\tX2\tY2\tZ2",
        "",
        "1\t0\t1\t-2\t1500\t\t\t",
        "2\t0.025\t0\t250\t333.3333333\t1000\t2000\t3000",
        "",
    ]
    np.testing.assert_allclose(load(path, up="y").positions, positions)
    named = Motion(positions, Skeleton(["hip", "left\tknee"]), 40)
    refused(lambda: save(named, tmp_path / "named.trc"), r"'left\tknee'", "printable")


def test_a_clip_from_trc_keeps_unit_axes_frames_times_and_header(tmp_path, refused):
    motion = load(write(tmp_path, TEXT), up="z", skip_first=True)
    path = save(motion.with_positions(motion.positions + 0.001, "moved"), tmp_path / "back.trc")
    lines = path.read_text().split("\n")
    assert lines[2] == "100.00\t100.00\t2\t2\tmm\t200.00\t1\t99"
    assert lines[6:] == ["8\t0.07\t\t\t\t2\t1\t4", "9\t0.08\t5\t4\t\t\t\t", ""]
    one = save(motion.select(["L ASIS"]), tmp_path / "one.trc").read_text().split("\n")
    assert one[2:5] == ["100.00\t100.00\t2\t1\tmm\t200.00\t1\t99", "Frame#\tTime\tL ASIS\t\t", "\t\tX1\tY1\tZ1"]
    cut = replace(motion, positions=motion.positions[1:], observed=None)
    refused(lambda: save(cut, tmp_path / "cut.trc"), "1 frame", "2 frames", "source.frames")


@given(st.data())
def test_round_trip_keeps_ten_digits(tmp_path_factory, data):
    path = tmp_path_factory.mktemp("trc") / "clip.trc"
    names = data.draw(
        st.lists(st.text(st.characters(codec="ascii", categories="LN"), min_size=1), unique=True, min_size=1)
    )
    frames = data.draw(st.integers(1, 5))
    values = st.floats(-1e3, 1e3) | st.just(NAN)
    drawn = data.draw(st.lists(values, min_size=3 * frames * len(names), max_size=3 * frames * len(names)))
    motion = Motion(np.array(drawn).reshape(frames, len(names), 3), Skeleton(names), data.draw(st.floats(1, 1e3)))
    back = load(save(motion, path), up="y")
    np.testing.assert_allclose(back.positions, motion.positions, rtol=1e-9)
    assert (back.names, back.fps) == (motion.names, pytest.approx(motion.fps))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("PathFileType", "<html>", ["line 1", "'<html>", "PathFileType"]),
        ("Frame#", "Time", ["line 4", "Frame#"]),
        ("R.ASIS\t\t\tL ASIS", "\t\t\t", ["line 4", "names of the markers"]),
        ("L ASIS", "R.ASIS", ["'R.ASIS'", "more than once"]),
        ("\tZ2", "", ["line 5", "5 coordinates", "2 markers"]),
        ("\n100.00", "\n0", ["line 3", "DataRate '0'", "--fps"]),
        ("\n100.00", "\n", ["line 3", "DataRate ''"]),
        ("80.9832", "80.98.32", ["line 7", "'80.98.32'", "finite number"]),
        ("80.9832", "80,9832", ["line 7", "'80,9832'"]),
        ("80.9832", "1e999", ["infinite", "'R.ASIS'"]),
        ("80.9832", "1\t80.9832", ["line 7", "9 cells", "2 markers"]),
        ("\t2\t3\n", "\t2\n", ["line 8", "7 cells", "cut off"]),
        ("\n9\t", "\n10\t", ["line 9", "frame 10 where 9 is due", "blank cells"]),
        (TEXT[TEXT.index("7\t0.06") :], "", ["line 7", "before the first frame"]),
        (TEXT[TEXT.index("Frame#") :], "", ["line 4", "inside its header"]),
        (TEXT, "", ["empty"]),
        ("ASIS", "AS\0IS", ["line 4", "text"]),
    ],
)
def test_each_defect_is_told_in_one_sentence(tmp_path, refused, old, new, words):
    assert old in TEXT
    path = write(tmp_path, TEXT.replace(old, new, 1))
    refused(lambda: load(path, up="y"), str(path), *words)


def test_the_real_file_shows_the_box_of_the_c3d_beside_it(shared_data):
    with pytest.warns(MotionFormatWarning, match="'652': took the 93 frames"):
        motion = load(shared_data / "markers" / "markers.trc", up="z")
    other = load(shared_data / "markers" / "markers_analogs.c3d")
    assert motion.positions.shape == (93, 51, 3)
    assert (motion.fps, motion.unit) == (100, 0.001)
    assert {name.removeprefix("boite_") for name in motion.names} == {name.split(":")[1] for name in other.names}
    box = [name for name in motion.names if name.startswith("boite_")]
    clips = motion.select(box), other.select([name.replace("_", ":", 1) for name in box])
    one, two = (
        np.nanmedian(np.linalg.norm(clip.positions[:, :, None] - clip.positions[:, None], axis=-1), 0) for clip in clips
    )
    np.testing.assert_allclose(one, two, atol=0.001)
    assert one.max() > 0.5
