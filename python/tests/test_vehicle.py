"""Vehicle files and the catalogue of effects."""

from pathlib import Path

import downwash as dw
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
