"""Batches of takes in Zarr stores: the answer of a take is that of the clip, read and written in parts."""

import json
import os
from pathlib import Path

import numpy as np
import pytest
from batches import CHAIN, FAST, again, here, lines, motion
from helpers import TOLERANCE

from motionrecover import Motion, from_xarray, to_xarray
from motionrecover.batch import Settings, plan, run, stores
from motionrecover.io import MotionFormatError
from motionrecover.recovery import recover_motion

xarray = pytest.importorskip("xarray")
zarr = pytest.importorskip("zarr")

pytestmark = pytest.mark.filterwarnings("ignore::FutureWarning")  # of Zarr, on how names are stored


def store(motion, path, version=3):
    dataset = to_xarray(motion) if isinstance(motion, Motion) else motion
    dataset.to_zarr(path, zarr_format=version, consolidated=False)


def opened(path):
    return xarray.open_zarr(path, chunks=None, consolidated=False).load()


def records(folder):
    return {record["output"]: record for record in lines(folder)}


def contents(folder):
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(Path(folder).rglob("*")) if p.is_file()}


def whole(path, settings=FAST):
    """What `recover` makes of the take in memory."""
    return recover_motion(from_xarray(opened(path)), **settings.recovery)


def positions(path, individual=0):
    return opened(path)["position"].values[..., individual].transpose(0, 2, 1)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("version", [2, 3])
def test_a_take_is_recovered_as_the_clip_is(folder, version):
    store(motion(0, 90), "in/deep/takes.zarr/monday/walk", version)
    store(motion(1, 90), "in/one.zarr", version)
    Path("in/deep/takes.zarr/.hidden/position").mkdir(parents=True)
    assert again(["in"], "out") == ["one.zarr", "deep/takes.zarr/monday/walk"]
    for name in ("deep/takes.zarr/monday/walk", "one.zarr"):
        np.testing.assert_array_equal(positions(f"out/{name}"), whole(f"in/{name}").positions)
        answer = from_xarray(opened(f"out/{name}"))
        assert answer.skeleton.edges == CHAIN.edges
        assert "recovered with robust" in answer.history[1]
    found = records("out")["one.zarr"]
    assert (found["frames"], found["joints"], found["samples"]) == (90, 5, found["samples"])
    assert sum(found["samples"].values()) == 90 * 5
    assert zarr.open_group("out/deep/takes.zarr", mode="r").metadata.zarr_format == version
    assert again(["in"], "out") == []
    # The store by its name; a changed take and a damaged answer alone are done again.
    assert again(["in/deep/takes.zarr"], "other") == ["takes.zarr/monday/walk"]
    before = contents("out/one.zarr")
    os.truncate(max(Path("out/one.zarr/position").rglob("*"), key=lambda path: path.stat().st_size), 10)
    assert again(["in"], "out") == ["one.zarr"]
    assert contents("out/one.zarr") == before
    (next(path for path in Path("in/one.zarr/position").rglob("*0") if path.is_file())).write_bytes(b"nothing")
    assert again(["in"], "out") == ["one.zarr"]
    assert records("out")["one.zarr"]["status"] == "failed"
    assert contents("out/one.zarr") == before
    assert not [path for path in Path("out").rglob(".*") if not path.name.startswith(".z")]


def test_a_long_take_is_read_in_parts_whose_answers_fade(folder, monkeypatch):
    store(motion(0, 200), "in.zarr")
    asked, exact = [], whole("in.zarr", Settings()).positions
    monkeypatch.setattr(stores, "PART", 60)
    monkeypatch.setattr(stores, "OVERLAP", 20)
    monkeypatch.setattr(stores, "STORED", 25)
    taken = stores.from_xarray

    def counting(dataset, **options):
        asked.append(dataset.sizes["time"])
        return taken(dataset, **options)

    monkeypatch.setattr(stores, "from_xarray", counting)
    again(["in.zarr"], "out", Settings())
    assert len(asked) == 5
    assert max(asked) <= 60
    found = positions("out/in.zarr")
    # Bones that every part finds alike, and samples that nothing is wrong with: parts agree with the whole.
    np.testing.assert_allclose(found, exact, atol=TOLERANCE["parts"])
    lengths = CHAIN.bone_lengths_of(found.astype(float))
    np.testing.assert_allclose(lengths, lengths.mean(0, keepdims=True).repeat(200, 0), atol=TOLERANCE["parts"])
    record = records("out")["in.zarr"]
    assert sum(record["samples"].values()) == 200 * 5
    assert opened("out/in.zarr")["time"].values[-1] == 199 / 60
    assert zarr.open_group("out/in.zarr", mode="r")["position"].chunks[0] == 25


def test_parts_fade_by_distance_and_certainty():
    """Over the shared frames the answer goes from the first part's to the second's, and the certain one counts."""

    def part(start, stop, value, trust):
        return stores._Part(slice(start, stop), np.full((stop - start, 2, 3), value), np.full((stop - start, 2), trust))

    first, second = part(0, 30, 0.0, 1.0), part(20, 50, 1.0, 1.0)
    first.positions[25, 0] = second.positions[7, 1] = np.nan  # frames 25 and 27
    found = np.concatenate(list(stores._faded([first, second, part(40, 60, 1.0, 1.0)])))
    assert found.shape == (60, 2, 3)
    assert (found[:20] == 0).all()
    assert (found[30:] == 1).all()
    fading = found[20:30, 0, 0].copy()
    assert fading[5] == 1
    assert found[27, 1, 0] == 0
    fading[5] = (fading[4] + fading[6]) / 2
    np.testing.assert_allclose(fading, np.arange(1, 11) / 11)
    sure = np.concatenate(list(stores._faded([part(0, 30, 0.0, 1e6), part(20, 50, 1.0, 1.0)])))
    assert (sure[20:29] < 1e-3).all()


def test_individuals_and_parts_that_nobody_is_in(folder, monkeypatch):
    away = motion(1, 120)
    away = away.with_positions(np.where(np.arange(120)[:, None, None] < 60, away.positions, np.nan), "left")
    both = [to_xarray(motion(0, 120), "one"), to_xarray(away, "two")]
    store(xarray.concat(both, "individuals", combine_attrs="override"), "in.zarr")
    monkeypatch.setattr(stores, "PART", 50)
    monkeypatch.setattr(stores, "OVERLAP", 10)
    again(["in.zarr"], "out", Settings())
    assert list(opened("out/in.zarr")["individuals"].values) == ["one", "two"]
    assert np.isfinite(positions("out/in.zarr", 0)).all()
    assert np.isfinite(positions("out/in.zarr", 1)[:40]).all()
    assert np.isnan(positions("out/in.zarr", 1)[-30:]).all()
    record = records("out")["in.zarr"]
    assert (record["frames"], record["joints"]) == (120, 10)
    assert record["samples"]["unknown"] >= 30 * 5
    nobody = both[0].copy(deep=True)
    nobody["position"][:] = np.nan
    store(nobody, "empty.zarr")
    again(["empty.zarr"], "other")
    assert "no measured sample" in records("other")["empty.zarr"]["reason"]


def test_what_is_no_take_or_not_to_be_trusted_is_refused(folder, refused):
    def reason(name):
        again([name], "out")
        return records("out")[name].get("reason", "")

    store(to_xarray(motion(0, 90)).drop_vars("keypoints"), "nameless.zarr")
    assert "holds no keypoints" in reason("nameless.zarr")
    store(motion(0, 90), "pickled.zarr", 2)
    metadata = Path("pickled.zarr/position/.zarray")
    metadata.write_text(json.dumps(json.loads(metadata.read_text()) | {"filters": [{"id": "pickle", "protocol": 5}]}))
    assert "asks for pickle" in reason("pickled.zarr")
    store(motion(0, 90), "long.zarr", 2)
    for name in ("position", "confidence", "time"):
        metadata = Path("long.zarr", name, ".zarray")
        told = json.loads(metadata.read_text())
        metadata.write_text(json.dumps(told | {"shape": [10**9, *told["shape"][1:]]}))
    assert "times its size in memory" in reason("long.zarr")
    store(motion(0, 90), "thick.zarr", 2)
    metadata = Path("thick.zarr/position/.zarray")
    metadata.write_text(json.dumps(json.loads(metadata.read_text()) | {"chunks": [10**8, 3, 5, 1]}))
    assert "rechunk" in reason("thick.zarr")
    Path("broken.zarr/position").mkdir(parents=True)
    assert "broken.zarr" in reason("broken.zarr")
    store(motion(0, 90), "fine.zarr")
    jobs = plan(["fine.zarr"], "out")
    refused(lambda: run(jobs, "out", Settings(report=True), here), "fine.zarr", "no page", error=ValueError)
    Path("none.zarr").mkdir()
    refused(lambda: plan(["none.zarr"], "out"), "gives no motion file", error=ValueError)
    refused(lambda: plan(["fine.zarr"], "fine.zarr/out"), "lie in each other", error=ValueError)
    refused(lambda: plan(["fine.zarr"], "."), "lie in each other", error=ValueError)
    Path("linked").mkdir()
    Path("linked/fine.zarr").symlink_to("../elsewhere")
    refused(lambda: plan(["fine.zarr"], "linked"), "linked/fine.zarr", "link", error=ValueError)
    with pytest.raises(MotionFormatError, match="no Zarr group"):
        stores._opened(Path("nowhere"))


def test_half_written_takes_go_when_the_next_batch_starts(folder):
    store(motion(0, 90), "in/takes.zarr/walk")
    again(["in"], "out")
    before = contents("out/takes.zarr")
    Path("out/takes.zarr/.0123456789abcdef/position").mkdir(parents=True)
    assert again(["in"], "out") == []
    assert contents("out/takes.zarr") == before
    assert not Path("out/takes.zarr/.0123456789abcdef").exists()
