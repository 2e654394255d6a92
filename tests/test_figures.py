import builtins

import numpy as np
import pytest
from report_clips import large, planted

from motionrecover import corrupt
from motionrecover.figures import FIGURES, changes_figure, recovery_figure, write_figures
from motionrecover.motion import Motion
from motionrecover.skeleton import Skeleton
from motionrecover.synthetic import synthesize


@pytest.fixture(scope="module")
def clips():
    truth = synthesize(2, 60, 0)
    corrupted, _ = corrupt.mixed(truth.positions, 1)
    recovered = truth.positions + 0.002
    return truth, truth.with_positions(corrupted, "corrupted"), truth.with_positions(recovered, "recovered")


def is_png(path):
    return path.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


def test_with_truth(clips, tmp_path):
    recovery_figure(*clips, tmp_path / "with.png")
    assert is_png(tmp_path / "with.png")
    assert [path.name for path in tmp_path.iterdir()] == ["with.png"]


def test_without_truth(clips, tmp_path):
    recovery_figure(None, *clips[1:], tmp_path / "without.png")
    assert is_png(tmp_path / "without.png")


def test_markers_without_bones_and_one_that_was_never_seen(tmp_path):
    rng = np.random.default_rng(0)
    truth = Motion(rng.normal(size=(40, 2, 3)), Skeleton(["one", "two"]), 30.0)
    holed = truth.positions.copy()
    holed[:, 1] = np.nan
    recovery_figure(truth, truth.with_positions(holed, "holed"), truth, tmp_path / "markers.png")
    assert is_png(tmp_path / "markers.png")


def test_one_frame(tmp_path):
    still = synthesize(0.01, 100)
    recovery_figure(still, still, still, tmp_path / "still.png")
    assert is_png(tmp_path / "still.png")


def test_different_clips_are_refused(clips, tmp_path):
    truth, corrupted, recovered = clips
    with pytest.raises(ValueError, match="received truth of 60 frames"):
        recovery_figure(synthesize(1, 60, 0), corrupted, recovered, tmp_path / "never.png")
    with pytest.raises(ValueError, match="same frames and joints"):
        recovery_figure(truth, corrupted.select(truth.names[:5]), recovered, tmp_path / "never.png")
    assert not list(tmp_path.iterdir())


def test_a_folder_of_figures(tmp_path):
    clip, recovery, truth = planted()
    recovered = truth.with_positions(recovery.positions, "recovered")
    write_figures(tmp_path / "new", truth, clip, recovered, recovery)
    assert all(is_png(tmp_path / "new" / name) for name in FIGURES)
    with pytest.raises(FileExistsError, match="exists already"):
        write_figures(tmp_path / "new", truth, clip, recovered, recovery)


def test_a_change_of_one_frame_is_seen_in_the_picture(tmp_path):
    from matplotlib.image import imread

    clip, recovery = large(10_000, 10)
    changes_figure(clip, recovery, tmp_path / "changes.png")
    picture = imread(tmp_path / "changes.png")[..., :3]
    repaired = np.abs(picture - np.array([0x8F, 0x3D, 0x00]) / 255).max(-1) < 0.02
    rows, columns = np.nonzero(repaired)
    assert len(rows) > 10
    assert columns.max() - columns.min() < 4


def test_missing_matplotlib_names_the_remedy(clips, tmp_path, monkeypatch):
    real = builtins.__import__

    def without_matplotlib(name, *rest):
        if name.startswith("matplotlib"):
            raise ImportError(name)
        return real(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without_matplotlib)
    with pytest.raises(ImportError, match=r"pip install motionrecover\[figures\]"):
        recovery_figure(*clips, tmp_path / "never.png")
