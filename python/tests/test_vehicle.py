"""Vehicle files and the catalogue of effects."""

from pathlib import Path
from typing import Any

import downwash as dw
import numpy as np
import pytest

from conftest import ROOT


def test_the_catalogue_has_equation_unit_and_range() -> None:
    rows = dw.effects()
    by_id = {row["id"]: row for row in rows}
    assert len(by_id) >= 22
    assert by_id["rotor_drag"]["unit"] == "kg/s"
    assert "F_body = -nr" in by_id["rotor_drag"]["equation"]
    assert "Faessler" in by_id["rotor_drag"]["about"]
    assert all(row["least"] < row["most"] and row["equation"] for row in rows)


def test_added_effects_keep_the_files_comments(tmp_path: Path) -> None:
    source = ROOT / "config/vehicles/crazyflie.toml"
    vehicle = dw.Vehicle(source).with_effects({"rotor_drag": {"d_xy": 0.02}})
    vehicle.save(tmp_path / "v.toml")
    text = (tmp_path / "v.toml").read_text()
    comments = [line for line in source.read_text().splitlines() if line.startswith("#")]
    assert comments and all(comment in text for comment in comments)
    again = dw.Vehicle(tmp_path / "v.toml")
    assert again.to_dict() == vehicle.to_dict()
    assert again.to_dict()["modelled_effects"]["rotor_drag"]["d_xy"] == 0.02
    vehicle.save(tmp_path / "v.json")
    assert dw.Vehicle(tmp_path / "v.json").to_dict() == vehicle.to_dict()


def test_vehicles_are_equal_by_their_numbers(tmp_path: Path) -> None:
    vehicle = dw.Vehicle()
    vehicle.save(tmp_path / "v.json")
    same = dw.Vehicle(tmp_path / "v.json")
    assert vehicle == same and hash(vehicle) == hash(same)
    assert vehicle != vehicle.with_effects({"wind": {"north_m_s": 1.0}}) and vehicle != vehicle.name


def test_an_effect_of_another_type_is_refused_in_words() -> None:
    values: list[Any] = [True, "1", None, {}]
    for value in values:
        with pytest.raises(ValueError, match="expected a number, or a list of three numbers"):
            dw.Plant(effects={"wind": {"north_m_s": value}})
    still = dw.Plant(effects={"wind": {"north_m_s": np.longdouble(1)}})  # type: ignore[dict-item]
    assert still.air_velocity_m_s[0] == 1.0


def test_init_builds_a_vehicle_or_names_missing_values() -> None:
    measured = {
        "mass_kg": 1.0,
        "arm_m": 0.2,
        "hover_throttle": 0.45,
        "propeller_inch": 9.0,
        "torque_ratio_m": 0.016,
        "motor_lag_s": 0.04,
        "cells": 4,
    }
    vehicle = dw.Vehicle.init(name="mine", **measured)  # type: ignore[arg-type]
    assert vehicle.name == "mine" and vehicle.to_dict()["mass"] == 1.0
    with pytest.raises(dw.DownwashError, match="mass"):
        dw.Vehicle.init(name="mine", arm_m=0.2)


def test_init_builds_a_vehicle_from_a_px4_log(practice: Path) -> None:
    try:
        vehicle = dw.Vehicle.init(practice / "px4_drag/flight_1.ulg", mass_kg=1.0)
    except dw.DownwashError as lacking:
        assert "the vehicle file lacks" in str(lacking)
    else:
        assert vehicle.to_dict()["mass"] == 1.0
