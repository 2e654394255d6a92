"""CSV: exact round trips, foreign tables, and one sentence for each defect."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from motionrecover.io import MotionFormatWarning, load, save
from motionrecover.motion import Motion
from motionrecover.skeleton import Skeleton

WIDE = """# fps: 100
# unit: cm
# up: z
# parents: -1, 0
frame,hip_x,hip_y,hip_z,knee_x,knee_y,knee_z
0,100,200,300,4,5,6
1,,nan,7,7,8,9
"""
LONG = """# fps: 100
# unit: m
# up: y
# bones: hip-knee
frame,joint,x,y,z,confidence
3,hip,1,2,3,0.5
3,knee,4,5,6,0.25
5,hip,,8,9,
"""


def write(folder, text, name="clip.csv"):
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def same(one: Motion, other: Motion):
    """Two motions agree bit for bit, the last line of history of the second aside."""
    assert one.positions.dtype == other.positions.dtype
    np.testing.assert_array_equal(one.positions, other.positions)
    finite = np.isfinite(one.positions)
    np.testing.assert_array_equal(np.signbit(one.positions)[finite], np.signbit(other.positions)[finite])
    np.testing.assert_array_equal(one.observed, other.observed)
    assert (one.confidence is None) == (other.confidence is None)
    if one.confidence is not None:
        np.testing.assert_array_equal(one.confidence, other.confidence)
    assert (one.skeleton, one.fps) == (other.skeleton, other.fps)
    assert one.history == other.history[:-1]


@st.composite
def motions(draw):
    frames, joints = draw(array_shapes(min_dims=2, max_dims=2, max_side=4))
    width = draw(st.sampled_from([32, 64]))
    far = 999_999_936.0  # the last float32 below FARTHEST
    numbers = st.floats(-far, far, width=width) | st.just(np.nan)
    positions = draw(arrays(f"f{width // 8}", (frames, joints, 3), elements=numbers))
    text = st.text(st.characters(codec="utf-8", exclude_categories=["C", "Z"]), min_size=1, max_size=6)
    names = draw(st.lists(text, min_size=joints, max_size=joints, unique=True))
    bones = st.tuples(st.integers(0, joints - 1), st.integers(0, joints - 1)).filter(lambda bone: bone[0] != bone[1])
    edges = draw(st.lists(bones, max_size=5, unique_by=frozenset)) if joints > 1 else []
    skeleton = Skeleton(names, edges)
    offsets = draw(st.none() | arrays(float, (joints, 3), elements=st.floats(-9, 9)))
    try:
        skeleton = Skeleton(names, edges, offsets)
    except ValueError:
        skeleton = Skeleton(names, edges)
    return Motion(
        positions,
        skeleton,
        draw(st.floats(1e-3, 1e4)),
        observed=draw(st.none() | arrays(bool, (frames, joints))),
        confidence=draw(st.none() | arrays(float, (frames, joints), elements=st.floats(0, 1) | st.just(np.nan))),
        history=tuple(draw(st.lists(st.text(max_size=9), max_size=2))),
    )


@pytest.mark.parametrize("format", ["csv", "csv-long"])
@settings(deadline=None, max_examples=60, derandomize=True)
@given(motion=motions())
def test_round_trip_is_exact(tmp_path_factory, format, motion):
    path = tmp_path_factory.mktemp("csv") / "clip.csv"
    same(motion, load(save(motion, path, format=format)))


def test_wide_table_is_converted_to_metres_with_y_up(tmp_path):
    motion = load(write(tmp_path, WIDE))
    assert (motion.fps, motion.unit, motion.up, motion.skeleton.edges) == (100, 0.01, "z", ((0, 1),))
    np.testing.assert_allclose(motion.positions[0], [[1, 3, -2], [0.04, 0.06, -0.05]])
    np.testing.assert_allclose(motion.positions[1, 0], [np.nan, 0.07, np.nan])
    assert motion.observed.tolist() == [[True, True], [False, True]]


def test_x_up_is_turned_not_mirrored(tmp_path):
    motion = load(write(tmp_path, WIDE), unit="m", up="x")
    np.testing.assert_allclose(motion.positions[0, 1], [-5, 4, 6])


def test_long_table_leaves_pairs_without_a_row_missing(tmp_path):
    motion = load(write(tmp_path, LONG))
    assert motion.names == ("hip", "knee")
    assert motion.observed.tolist() == [[True, True], [False, False], [False, False]]
    np.testing.assert_array_equal(motion.positions[0], [[1, 2, 3], [4, 5, 6]])
    np.testing.assert_array_equal(motion.positions[2, 0], [np.nan, 8, 9])
    np.testing.assert_array_equal(motion.confidence, [[0.5, 0.25], [np.nan, np.nan], [np.nan, np.nan]])


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("_", "."),
        ("_", " "),
        (",", ";"),
        (",", "\t"),
        ("frame,", "Frame,"),
        ("_x", "_X"),
        ("\n", "\r\n"),
        ("-1, 0", "[-1, 0]"),
        ("parents: -1, 0", "bones: hip-knee"),
        ("parents: -1, 0", 'bones: [["hip", "knee"]]'),
        ("cm", "0.01"),
    ],
)
def test_spellings_that_mean_the_same(tmp_path, old, new):
    comments, table = WIDE.split("frame", 1)
    text = WIDE.replace(old, new) if old in comments and old != "," else comments + ("frame" + table).replace(old, new)
    motion, expected = load(write(tmp_path, text)), load(write(tmp_path, WIDE, "same.csv"))
    np.testing.assert_array_equal(motion.positions, expected.positions)
    assert motion.skeleton == expected.skeleton


def test_arguments_go_before_the_file(tmp_path):
    skeleton = Skeleton(["knee", "hip"], [(1, 0)])
    motion = load(write(tmp_path, WIDE), fps=10, unit="1", up="y", skeleton=skeleton)
    assert (motion.fps, motion.unit, motion.up, motion.skeleton) == (10, 1, "y", skeleton)
    np.testing.assert_array_equal(motion.positions[0], [[4, 5, 6], [100, 200, 300]])


def test_skeleton_file_and_standard_names(tmp_path, refused):
    bare = WIDE.replace("# parents: -1, 0\n", "")
    file = write(tmp_path, 'names = ["hip", "knee"]\nparents = [-1, 0]', "bones.toml")
    assert load(write(tmp_path, bare), skeleton=file).skeleton.edges == ((0, 1),)
    refused(lambda: load(write(tmp_path, bare), skeleton=tmp_path / "none.toml"), "clip.csv", "none.toml")
    refused(lambda: load(write(tmp_path, bare), skeleton="smpl24"), "clip.csv", "'hip'", "pelvis")
    standard = Skeleton.standard("cmu21")
    columns = ",".join(f"{name}_{axis}" for name in reversed(standard.names) for axis in "xyz")
    text = f"# fps: 1\n# unit: m\n# up: y\n{columns}\n" + ",".join(map(str, range(63)))
    motion = load(write(tmp_path, text))
    assert motion.skeleton == standard
    np.testing.assert_array_equal(motion.positions[0, 0], [60, 61, 62])


def test_without_bones_and_without_a_header_there_are_none(tmp_path, refused):
    with pytest.warns(MotionFormatWarning, match="no distance stays the same"):
        motion = load(write(tmp_path, WIDE.replace("# parents: -1, 0\n", "")))
    assert motion.skeleton == Skeleton(["hip", "knee"])
    bare = "1,2,3,4,5,6\n\n7,8,9,,,\n"
    with pytest.warns(MotionFormatWarning) as said:
        motion = load(write(tmp_path, bare), unit="m", fps=50, up="y")
    assert any("no header" in str(warning.message) for warning in said)
    assert motion.skeleton == Skeleton(["marker1", "marker2"])
    np.testing.assert_array_equal(motion.positions, [[[1, 2, 3], [4, 5, 6]], [[7, 8, 9], [np.nan] * 3]])
    refused(lambda: load(write(tmp_path, bare)), "clip.csv", "--fps")
    refused(lambda: load(write(tmp_path, bare + "1,2,3\n"), unit="m", fps=50), "line 4", "3 cells")
    refused(lambda: load(write(tmp_path, "0,1,2,3\n1,4,5,6\n"), unit="m", fps=50), "line 1", "'0'")


def test_the_real_walk_without_a_header_is_read(shared_data):
    with pytest.warns(MotionFormatWarning):
        motion = load(shared_data / "markers" / "gait-raw.csv", unit="mm", fps=50)
    assert motion.positions.shape == (142, 13, 3)
    assert 0.94 < motion.observed.mean() < 0.95


def test_names_with_dashes_need_one_reading(tmp_path, refused):
    text = WIDE.replace("hip", "a-b").replace("knee", "c")
    assert load(write(tmp_path, text.replace("parents: -1, 0", "bones: a-b-c"))).skeleton.edges == ((0, 1),)
    two = text.replace("c_", "b-a_").replace("parents: -1, 0", "bones: a-b-a")
    refused(lambda: load(write(tmp_path, two)), "line 4", "'a-b-a'", '[["a", "b"]')


def test_up_axis_is_assumed_aloud(tmp_path):
    path = write(tmp_path, WIDE.replace("# up: z\n", ""))
    with pytest.warns(MotionFormatWarning, match=r"clip\.csv states no up axis: assumed y, .* up= ") as said:
        motion = load(path)
    assert motion.up == "y"
    assert said[0].filename == __file__
    assert str(said[0].message) in motion.history


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (WIDE, "", ["empty"]),
        ("# fps: 100\n", "", ["no fps", "fps=", "--fps"]),
        ("# unit: cm\n", "", ["no unit", "unit=", "--unit"]),
        ("100\n", "-3\n", ["line 1", "-3", "frame rate"]),
        ("cm", "yard", ["line 2", "'yard'", "unit"]),
        ("up: z", "up: w", ["line 3", "'w'", "up"]),
        ("-1, 0", "-1, x", ["line 4", "parents"]),
        ("-1, 0", "-1", ["line 4", "1 parents"]),
        ("parents: -1, 0", "bones: [[1, 2, 3]]", ["line 4", "pairs"]),
        ("parents: -1, 0", "bones: hip-shank", ["line 4", "'hip-shank'"]),
        ("# parents", "# rest_offsets: [[0]]\n# parents", ["line 5", "rest offsets"]),
        ("# parents", "# rest_offsets: [[0], 1]\n# parents", ["line 4", "[x, y, z]"]),
        ("# parents", "# dtype: int\n# parents", ["line 4", "'int'"]),
        ("# parents", "# history: 3\n# parents", ["line 4", "JSON list"]),
        ("hip_y", "hip_w", ["line 5", "'hip_w'"]),
        ("hip_y,", "", ["line 5", "'hip'", "without y"]),
        ("hip_y", "hip_x", ["line 5", "'hip_x'", "twice"]),
        ("knee_z", "time", ["line 5", "knee_z"]),
        (WIDE[WIDE.index("0,100") :], "", ["no rows"]),
        (WIDE[WIDE.index("frame,") :], "", ["no header"]),
        ("300,4", "300;4", ["line 6", "6 cells", "7 columns"]),
        ("300", "3OO", ["line 6", "'3OO'", "'hip_z'"]),
        ("300", "inf", ["line 6", "'inf'", "'hip_z'"]),
        ("300", '"300', ["quotation marks"]),
        ("\n1,", "\n2,", ["line 7", "frame 2 after 0"]),
        ("\n1,", "\n1.5,", ["line 7", "frame 1.5"]),
    ],
)
def test_each_defect_of_a_wide_table_is_told_in_one_sentence(tmp_path, refused, old, new, words):
    assert old in WIDE
    path = write(tmp_path, WIDE.replace(old, new, 1))
    refused(lambda: load(path), str(path), *words)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("confidence", "trust", ["line 5", "'trust'"]),
        ("frame,", "time,", ["line 5", "no column frame"]),
        ("3,knee", "3,hip", ["line 7", "frame 3 of joint 'hip' again"]),
        ("5,hip", "5000000,hip", ["frames 3 to 5000000", "3 rows"]),
        ("5,hip", ",hip", ["line 8", "no frame"]),
        ("0.25", "sure", ["line 7", "'sure'", "'confidence'"]),
    ],
)
def test_each_defect_of_a_long_table_is_told_in_one_sentence(tmp_path, refused, old, new, words):
    assert old in LONG
    path = write(tmp_path, LONG.replace(old, new, 1))
    refused(lambda: load(path), str(path), *words)


@pytest.mark.parametrize("name", ["", " hip", "hip\n"])
def test_names_that_a_table_cannot_hold_are_refused(tmp_path, refused, name):
    motion = Motion(np.zeros((1, 1, 3)), Skeleton([name]), 30)
    refused(lambda: save(motion, tmp_path / "clip.csv"), repr(name))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("format", ["csv", "csv-long"])
def test_long_recordings_come_back(tmp_path, format):
    rng = np.random.default_rng(0)
    names = [f"joint{j}" for j in range(50)]
    motion = Motion(rng.normal(size=(2000, 50, 3)), Skeleton.from_parents(names, range(-1, 49)), 120)
    same(motion, load(save(motion, tmp_path / "clip.csv", format=format)))
