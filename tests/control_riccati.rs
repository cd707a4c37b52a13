//! The Riccati solver against SciPy's solution of a bare hover model, if that data is available.

use std::path::PathBuf;

use downwash::control::solve_dare;
use nalgebra::SMatrix;
use serde_json::Value;

fn matrix<const R: usize, const C: usize>(value: &Value) -> SMatrix<f64, R, C> {
    SMatrix::from_fn(|row, column| value[row][column].as_f64().expect("a number"))
}

#[test]
fn gain_matches_scipy() {
    let shared = std::env::var_os("DOWNWASH_SHARED")
        .map_or_else(|| PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared"), PathBuf::from);
    let path = shared.join("peers/problem/lqr_reference.json");
    let Ok(text) = std::fs::read_to_string(&path) else {
        println!("skipped: {} is not there", path.display());
        return;
    };
    let reference: Value = serde_json::from_str(&text).expect("JSON");
    let (q, r) = (matrix::<12, 12>(&reference["Q"]), matrix::<4, 4>(&reference["R"]));
    for case in ["euler", "zoh"] {
        let case = &reference[case];
        let (a, b) = (matrix::<12, 12>(&case["A"]), matrix::<12, 4>(&case["B"]));
        let (p, k) = (matrix::<12, 12>(&case["P"]), matrix::<4, 12>(&case["K"]));
        let solution = solve_dare(&a, &b, &q, &r).expect("a solution");
        let difference = (solution.gain - k).norm() / k.norm();
        assert!(difference < 1e-9, "gain differs by {difference:e}");
        assert!((solution.cost - p).norm() / p.norm() < 1e-9);
        assert!(solution.residual < 1e-12, "residual {:e}", solution.residual);
        let radius = case["closed_loop_abs_eigenvalues"][0].as_f64().expect("a number");
        assert!((solution.spectral_radius - radius).abs() < 1e-9);
    }
}
