"""Tunes the controller's weights with Optuna, on a vehicle that differs from its file.

    python tune.py 40
"""

import sys

import downwash as dw
import optuna

EFFECTS = {"wind": {"north_m_s": 2.0}, "rotor_drag": {"d_xy": 0.02}, "motor_lag": {"tau_s": 0.05}}


def error_m(weights: dict[str, object]) -> float:
    """Mean RMS distance from the figure of eight in two flights, m."""
    rows = dw.fly(trajectory="figure-8", effects=EFFECTS, controller=weights, seeds=[1, 2])
    if any(row["end"] != "done" for row in rows):
        return 10.0
    return sum(float(row["true_position_rmse_m"]) for row in rows) / len(rows)


def trial_error_m(trial: optuna.Trial) -> float:
    horizontal = trial.suggest_float("horizontal_m", 0.05, 1.0, log=True)
    vertical = trial.suggest_float("vertical_m", 0.05, 1.0, log=True)
    attitude = trial.suggest_float("attitude_command_rad", 0.05, 1.0, log=True)
    weights: dict[str, object] = {
        "position_m": [horizontal, horizontal, vertical],
        "attitude_command_rad": [attitude, attitude, 0.3],
    }
    return error_m(weights)


if __name__ == "__main__":
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    study = optuna.create_study(sampler=optuna.samplers.TPESampler(seed=1))
    study.optimize(trial_error_m, n_trials=int(sys.argv[1]))
    print(f"shipped {error_m({}):.4f} m")
    print(f"tuned {study.best_value:.4f} m, {study.best_params}")
