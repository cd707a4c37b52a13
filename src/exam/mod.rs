//! The blind exam of the diagnosis: draws vehicles, effects and flights from a seed, simulates the
//! flights, diagnoses them without the key, and scores the answers.

pub mod airframe;
pub mod answer;
pub mod attempts;
mod bench;
pub mod calibrate;
pub mod case;
pub mod closure;
pub mod condition;
pub mod deviations;
pub mod direction;
pub mod draw;
pub mod edit;
mod estimate;
pub mod fleet;
pub mod flight;
pub mod foreign;
pub mod grade;
pub mod ground;
pub mod interval;
pub mod key;
pub mod laws;
pub mod motion;
pub mod onsets;
pub mod order;
pub mod programme;
pub mod reliability;
pub mod score;
pub mod stored;
pub mod strength;
pub mod summary;
pub mod tolerances;
pub mod trap;
pub mod world;
