"""Files of weights: exact round trips, and one sentence for each defect."""

import json
import pickle

import equinox as eqx
import numpy as np
import pytest
from safetensors.numpy import save_file

from motionrecover.refine.bra import BRA
from motionrecover.refine.refiner import load_refiner
from motionrecover.refine.weights import VERSION, WeightsError, load_tensors, save_tensors, tensors_into, tensors_of


def rng(seed=0):
    return np.random.default_rng(seed)


NETWORK = BRA.make(5, rng(), (4, 6))


@pytest.fixture
def path(tmp_path):
    return save_tensors(tmp_path / "w.safetensors", tensors_of(NETWORK, "model."), {"model": "bra"})


def test_round_trip_is_exact(path):
    tensors, facts = load_tensors(path)
    assert facts["model"] == "bra"
    again = tensors_into(BRA.make(5, rng(1), (4, 6)), tensors, "model.", path)
    assert eqx.tree_equal(again, NETWORK)
    with pytest.raises(FileExistsError):
        save_tensors(path, tensors, facts)


def test_damaged_and_tampered_files_are_told(path, refused):
    whole = path.read_bytes()
    for size in (0, 5, 100, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:size])
        refused(lambda: load_tensors(path), str(path), "cut off", error=WeightsError)
    for content in (pickle.dumps([1]), b"PK" + whole):
        path.write_bytes(content)
        refused(lambda: load_tensors(path), str(path), "cut off", error=WeightsError)
    path.write_bytes(whole[:-1] + bytes([whole[-1] ^ 1]))
    refused(lambda: load_tensors(path), str(path), "changed", error=WeightsError)


def test_foreign_files_and_other_versions_are_told(path, refused):
    tensors, facts = load_tensors(path)
    save_file(tensors, path)
    refused(lambda: load_tensors(path), "another program", error=WeightsError)
    save_file(tensors, path, {"motionrecover": json.dumps(facts | {"version": VERSION + 1})})
    refused(lambda: load_tensors(path), f"version {VERSION + 1}", error=WeightsError)
    refused(lambda: load_tensors(path.parent / "none"), "none", "does not exist", error=WeightsError)


def test_another_shape_another_model_and_an_empty_description_are_told(path, refused):
    tensors, _ = load_tensors(path)
    wider = BRA.make(5, rng(), (4, 8))
    refused(lambda: tensors_into(wider, tensors, "model.", path), "shape (4, 6)", "(4, 8)", error=WeightsError)
    deeper = BRA.make(5, rng(), (4, 5, 6))
    refused(lambda: tensors_into(deeper, tensors, "model.", path), "another model", error=WeightsError)
    double = {name: tensor.astype(np.float64) for name, tensor in tensors.items()}
    refused(lambda: tensors_into(NETWORK, double, "model.", path), "float64", error=WeightsError)
    refused(lambda: load_refiner(path), "does not say what it holds", "joints", error=WeightsError)


def test_names_without_weights_and_folders_without_a_run_are_told(tmp_path, refused):
    refused(lambda: load_refiner("bra-dgn"), "no weights of 'bra-dgn'", "motionrecover train", error=ValueError)
    refused(lambda: load_refiner(tmp_path), str(tmp_path), "without weights", error=WeightsError)
