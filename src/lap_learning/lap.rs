//! How near the course a lap was flown.

use schemars::JsonSchema;
use serde::Serialize;

/// One lap.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize)]
pub struct Lap {
    /// Its number, from 1.
    pub number: u32,
    /// RMS distance from the desired position, m.
    pub rms_m: f64,
    /// Largest distance, m.
    pub most_m: f64,
    /// What was foreseen for the RMS distance when the model was learned, m.
    pub foreseen_m: Option<f64>,
    /// What it was planned through, in words.
    pub through: String,
}

impl Lap {
    /// One line.
    pub fn in_words(&self) -> String {
        let Self { number, rms_m, most_m, through, .. } = self;
        let foreseen = self.foreseen_m.map(|m| format!(" (foreseen {m:.3} m)")).unwrap_or_default();
        format!(
            "lap {number}: {rms_m:.4} m RMS{foreseen}, {most_m:.3} m at most, through {through}"
        )
    }
}

/// The present lap's errors.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct LapErrors {
    /// From 0.
    pub number: u32,
    /// Whether the searches of a training have run in it.
    pub is_prepared: bool,
    /// How far into it the vehicle is, 0..1.
    pub share: f64,
    /// Largest distance so far, m.
    pub most_m: f64,
    squares: f64,
    count: u32,
}

impl LapErrors {
    pub fn new(number: u32) -> Self {
        Self { number, ..Self::default() }
    }

    pub fn add(&mut self, distance_m: f64) {
        self.squares += distance_m * distance_m;
        self.most_m = self.most_m.max(distance_m);
        self.count += 1;
    }

    pub fn lap(&self, through: String, foreseen_m: Option<f64>) -> Lap {
        let rms_m = (self.squares / f64::from(self.count.max(1))).sqrt();
        Lap { number: self.number + 1, rms_m, most_m: self.most_m, foreseen_m, through }
    }
}
