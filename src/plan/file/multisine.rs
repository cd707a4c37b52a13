//! The multisine: sums of sinusoids, each with its own amplitude, period and phase, in position and
//! yaw.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::plan::curve::{Envelope, Harmonic, HarmonicCurve};
use crate::plan::trajectory::{DesiredPoint, Shape};

/// A trajectory file of the family `multisine`. At time 0 it is at `offset_m`, `altitude_m` and
/// `heading_deg`; each wave adds `amplitude (sin(2 pi t / period + phase) - sin(phase))`.
#[derive(Clone, Debug, Default, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(in crate::plan) struct Multisine {
    /// Height of the start above the take-off floor.
    pub altitude_m: f64,
    /// North and east offset of the start from the take-off point.
    #[serde(default)]
    pub offset_m: [f64; 2],
    /// Yaw at the start.
    #[serde(default)]
    pub heading_deg: f64,
    /// Constant part of the yaw rate.
    #[serde(default)]
    pub yaw_rate_deg_s: f64,
    /// Duration without the ramp, which adds `ramp_s`.
    pub duration_s: f64,
    /// Time to reach full speed, and to come to rest.
    #[serde(default = "two_seconds")]
    pub ramp_s: f64,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub north: Vec<Wave>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub east: Vec<Wave>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub up: Vec<Wave>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub yaw: Vec<YawWave>,
}

/// One sinusoid of a position axis.
#[derive(Clone, Copy, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(in crate::plan) struct Wave {
    pub amplitude_m: f64,
    pub period_s: f64,
    #[serde(default)]
    pub phase_deg: f64,
}

/// One sinusoid of the yaw angle.
#[derive(Clone, Copy, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(in crate::plan) struct YawWave {
    pub amplitude_deg: f64,
    pub period_s: f64,
    #[serde(default)]
    pub phase_deg: f64,
}

impl Multisine {
    /// The content of the trajectory file.
    pub fn to_toml(&self) -> String {
        // A struct of numbers and lists always serialises to a table.
        let body = toml::to_string(self).unwrap_or_default();
        format!("family = \"multisine\"\n{body}")
    }

    /// Its curve and its envelope.
    pub(super) fn shape(&self) -> Shape {
        Shape::Harmonic { curve: self.curve(), envelope: self.envelope() }
    }

    /// The desired points, `spacing_s` apart, from start to end.
    pub fn samples(&self, spacing_s: f64) -> Vec<DesiredPoint> {
        let (curve, envelope) = (self.curve(), self.envelope());
        let steps = (envelope.duration() / spacing_s).ceil() as usize;
        let at = |step: usize| (step as f64 * spacing_s).min(envelope.duration());
        (0..=steps).map(|step| curve.sample(envelope.phase(at(step)))).collect()
    }

    fn envelope(&self) -> Envelope {
        Envelope::new(self.duration_s, self.ramp_s)
    }

    fn curve(&self) -> HarmonicCurve {
        let [north, east] = self.offset_m;
        let yaw = Harmonic {
            rate: self.yaw_rate_deg_s.to_radians(),
            ..Harmonic::constant(self.heading_deg.to_radians())
        };
        let start = [north, east, -self.altitude_m].map(Harmonic::constant);
        let mut curve = HarmonicCurve::of_one(start, yaw);
        // A wave upwards is one downwards with the opposite sign.
        let axes = [(&self.north, 1.0), (&self.east, 1.0), (&self.up, -1.0)];
        for (harmonics, (waves, sign)) in curve.position.iter_mut().zip(axes) {
            harmonics.extend(
                waves
                    .iter()
                    .map(|wave| harmonic(sign * wave.amplitude_m, wave.period_s, wave.phase_deg)),
            );
        }
        curve.yaw.extend(
            self.yaw.iter().map(|wave| {
                harmonic(wave.amplitude_deg.to_radians(), wave.period_s, wave.phase_deg)
            }),
        );
        curve
    }
}

/// Default of `ramp_s`.
pub(super) fn two_seconds() -> f64 {
    2.0
}

fn harmonic(amplitude: f64, period_s: f64, phase_deg: f64) -> Harmonic {
    Harmonic { amplitude, period_s, phase: phase_deg.to_radians(), ..Harmonic::default() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::Trajectory;
    use std::path::Path;

    #[test]
    fn multisine_file_round_trips_and_starts_at_its_offset() {
        let wave = Wave { amplitude_m: 0.3, period_s: 3.0, phase_deg: 40.0 };
        let written = Multisine {
            altitude_m: 1.5,
            offset_m: [0.4, -0.2],
            heading_deg: 90.0,
            duration_s: 8.0,
            ramp_s: 2.0,
            north: vec![wave, Wave { period_s: 0.7, ..wave }],
            up: vec![wave],
            yaw: vec![YawWave { amplitude_deg: 20.0, period_s: 4.0, phase_deg: 0.0 }],
            ..Multisine::default()
        };
        let text = written.to_toml();
        let trajectory = Trajectory::parse(&text, Path::new("t.toml")).expect("a trajectory");
        assert_eq!(trajectory.duration(), 10.0);
        let start = trajectory.sample(0.0);
        assert_eq!(<[f64; 3]>::from(start.position), [0.4, -0.2, -1.5]);
        assert_eq!(start.velocity.norm(), 0.0);
        let samples = written.samples(0.5);
        assert_eq!(samples[7], trajectory.sample(3.5));
        // A quarter of the yaw wave's period after its start.
        assert!((trajectory.sample(2.0).yaw - 110f64.to_radians()).abs() < 1e-12);
    }

    #[test]
    fn invalid_multisine_numbers_are_refused_by_field() {
        let error = |wave: &str| {
            let text =
                format!("family='multisine'\naltitude_m=1\nduration_s=5\nnorth=[{{{wave}}}]");
            Trajectory::parse(&text, Path::new("t.toml")).expect_err("refused").to_string()
        };
        assert!(error("amplitude_m=1, period_s=0").contains("period_s"));
        assert!(error("amplitude_m=nan, period_s=1").contains("amplitude_m"));
        assert!(error("amplitude_m=1, period_s=1, phase=3").contains("phase"));
    }
}
