//! The tracking errors of a lap.

use schemars::JsonSchema;
use serde::Serialize;

/// A lap that was flown to its end.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize)]
pub struct Lap {
    /// Number of the lap, from 1.
    pub number: u32,
    /// RMS distance from the desired position, m.
    pub rms_m: f64,
    /// Largest distance from the desired position, m.
    pub most_m: f64,
    /// RMS distance predicted when the lap's model was learned, m; null unless that model is new.
    pub foreseen_m: Option<f64>,
    /// The model that the lap ended with, in words.
    pub through: String,
}

impl Lap {
    /// One line for people.
    pub fn text(&self) -> String {
        let Self { number, rms_m, most_m, through, .. } = self;
        let foreseen =
            self.foreseen_m.map(|m| format!(" (predicted {m:.3} m)")).unwrap_or_default();
        format!("lap {number}: {rms_m:.4} m RMS{foreseen}, {most_m:.3} m at most, with {through}")
    }
}

/// The errors of the lap in progress.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct LapErrors {
    /// Number of the lap, from 0.
    pub number: u32,
    /// Whether the long searches have run in this lap.
    pub is_prepared: bool,
    /// Fraction of the lap flown so far, 0..1.
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
