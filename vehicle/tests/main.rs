//! The vehicle model's integration tests in one binary. Several tests share `common`.

mod common;
#[path = "../benches/every_effect/mod.rs"]
mod every_effect;

mod batch;
mod closed_forms;
mod effects;
mod floor;
mod foreign_laws;
mod jacobian;
mod motion_under_effects;
mod practice_replay;
mod rotorpy;
mod vehicle_files;
