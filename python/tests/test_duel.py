"""The random vehicles of `benches/duel`, which do not need RAPTOR itself."""

import sys
from typing import Any

import downwash as dw
import numpy as np

from conftest import ROOT

sys.path.insert(0, str(ROOT / "benches" / "duel"))
import vehicles  # noqa: E402

DRAWN = [vehicles.draw(1, index) for index in range(40)]


def test_a_vehicle_depends_only_on_seed_and_index() -> None:
    assert vehicles.draw(1, 7) == DRAWN[7]
    assert vehicles.draw(2, 7) != DRAWN[7]


def test_vehicle_files_are_valid_without_effects() -> None:
    for drawn in DRAWN:
        vehicle = drawn.vehicle()
        assert vehicle.check() == []
        assert vehicle.to_dict()["modelled_effects"] == {}


def test_every_kind_but_trim_changes_the_motion() -> None:
    drawn = vehicles.draw(1, 0)
    rng = np.random.default_rng(1)
    outputs = np.array([0.45, 0.5, 0.55, 0.5]) * np.linspace(0.8, 1.2, 200)[:, None]
    start = [0, 0, -5, 1, 1, 0, 1, 0, 0, 0, 0, 0, 0]

    def end(effects: dict[str, Any] | None) -> np.ndarray:
        return dw.Plant(drawn.vehicle(), effects, state=start).rollout(outputs)[-1]

    for kind, make in vehicles.KINDS.items():
        effects = make(drawn.file, rng)
        if kind != "trim":
            assert not np.allclose(end(effects), end(None), rtol=0, atol=1e-6), kind


def test_vehicles_are_within_raptors_training_range() -> None:
    masses = [drawn.file["mass"] for drawn in DRAWN]
    assert min(masses) < 0.1 < 1.5 < max(masses)
    assert all(vehicles.within(drawn) for drawn in DRAWN)
    light = DRAWN[0]
    heavy = vehicles.Drawn("heavy", light.file, {"mass": {"mass_kg": 3.0}}, ())
    assert not vehicles.within(heavy)
