//! The events that adaptation reports, and how they read.

use std::fmt;

use super::Distrust;

/// Tilt offset from which the report names one weak rotor, rad.
const ROTOR_TILT_RAD: f64 = 0.04;

/// An event of adaptation to report.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum AdaptationEvent {
    /// Parameters have changed.
    Changed(ParameterChange),
    /// Adaptation is off until the next flight.
    SwitchedOff(Distrust),
}

/// The parameters that changed, and their new values.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ParameterChange {
    /// Time since the change began, s.
    pub began_s_ago: f64,
    /// Thrust over mass, relative to the file's.
    pub thrust_over_mass: Option<f64>,
    /// Push north and east, m/s^2.
    pub push: Option<[f64; 2]>,
    /// Offset of roll, pitch and yaw from the ones sent, rad.
    pub attitude: Option<[f64; 3]>,
}

impl ParameterChange {
    /// The rotor that lacks thrust, from the tilt that its moment causes; X layout.
    fn weak_rotor(&self) -> Option<&'static str> {
        let [roll, pitch, _] = self.attitude?;
        if roll.abs().min(pitch.abs()) < ROTOR_TILT_RAD {
            return None;
        }
        // Less thrust on the right rolls right, less in front turns the nose down.
        Some(match (roll > 0.0, pitch < 0.0) {
            (true, true) => "front right",
            (true, false) => "rear right",
            (false, true) => "front left",
            (false, false) => "rear left",
        })
    }
}

impl fmt::Display for ParameterChange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut between = "";
        if let Some(thrust) = self.thrust_over_mass {
            let (mass, thrust) = (100.0 * (1.0 / thrust - 1.0), 100.0 * (thrust - 1.0));
            let cause = match (self.weak_rotor(), thrust < 0.0) {
                (Some(_), true) => "",
                (_, true) => " (a payload, or a pack that sags)",
                (_, false) => " (less load, or more thrust than expected)",
            };
            write!(f, "mass {mass:+.0} % or thrust {thrust:+.0} %{cause}")?;
            between = "; ";
        }
        if let Some([north, east]) = self.push {
            let towards = east.atan2(north).to_degrees().rem_euclid(360.0);
            write!(
                f,
                "{between}push of {:.1} m/s^2 towards {towards:.0} deg (wind, or a trim)",
                north.hypot(east)
            )?;
            between = "; ";
        }
        if let Some([roll, pitch, yaw]) = self.attitude {
            let [roll, pitch, yaw] = [roll, pitch, yaw].map(f64::to_degrees);
            write!(
                f,
                "{between}moment that turns by roll {roll:+.1}, pitch {pitch:+.1}, yaw {yaw:+.1} deg"
            )?;
            if let Some(rotor) = self.weak_rotor() {
                write!(f, " (less thrust at the {rotor} rotor)")?;
            }
        }
        Ok(())
    }
}

impl fmt::Display for AdaptationEvent {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Changed(change) => write!(f, "adapted: {change}"),
            Self::SwitchedOff(distrust) => {
                write!(
                    f,
                    "adaptation is off for this flight: {distrust}; feedback continues without it"
                )
            }
        }
    }
}
