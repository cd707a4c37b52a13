//! A flight and its faults as data, which a campaign draws, shrinks and replays.

use serde::{Deserialize, Serialize};
use sitl::config::Autopilot;

use crate::supervisor::EngagePolicy;

/// Version of the format.
pub const VERSION: u32 = 1;

/// A flight with faults. The same script always gives the same flight, to the byte.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Script {
    /// [`VERSION`].
    pub schema_version: u32,
    /// Seed of noise, delays and gusts, and of the faults' random choices.
    pub seed: u64,
    /// Name of a shipped vehicle.
    pub vehicle: String,
    /// The autopilot whose behaviour the simulated vehicle has.
    pub autopilot: Autopilot,
    /// The id of the control law.
    pub law: String,
    /// Who decides that the flight begins: a command, or the pilot's switch.
    pub policy: EngagePolicy,
    /// Seconds of the vehicle's clock per second of the host's.
    pub clock_rate: f64,
    /// Whether both ends sign their frames (MAVLink 2), and reject all others.
    #[serde(default)]
    pub signed: bool,
    /// The trajectory, as the text of its file.
    pub trajectory: String,
    /// The faults of the flight.
    pub faults: Vec<Timed>,
}

/// A fault and its time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Timed {
    /// Simulated time at which it begins, s.
    pub at_s: f64,
    /// Duration, s; zero for an instantaneous fault.
    pub for_s: f64,
    /// The fault.
    pub fault: Fault,
}

/// A direction of the link.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Way {
    /// From the vehicle.
    Down,
    /// To the vehicle.
    Up,
    /// Both directions.
    Both,
}

impl Way {
    /// Whether frames from the vehicle are included.
    pub fn is_down(self) -> bool {
        self != Self::Up
    }

    /// Whether frames to the vehicle are included.
    pub fn is_up(self) -> bool {
        self != Self::Down
    }
}

/// The pilot's command from another ground station.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PilotAct {
    /// Select position hold.
    Position,
    /// Select the mode that keeps its place.
    Hold,
    /// Return home.
    Return,
    /// Land.
    Land,
    /// Select the mode that obeys setpoints.
    Offboard,
    /// Arm.
    Arm,
    /// Disarm, which the vehicle refuses in the air.
    Disarm,
    /// Stop the motors, even in the air.
    Kill,
}

/// A fault of the link, the vehicle, the pilot or a process.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum Fault {
    /// Each frame is lost with a probability.
    Loss {
        /// Affected direction.
        way: Way,
        /// Probability, 0..1.
        share: f64,
    },
    /// No frame passes.
    Cut {
        /// Affected direction.
        way: Way,
    },
    /// Frames of the mode (HEARTBEAT, CURRENT_MODE) do not arrive.
    ModeLost,
    /// Each frame gets its own delay. With jitter, frames overtake one another.
    Delay {
        /// Affected direction.
        way: Way,
        /// Least delay, s.
        least_s: f64,
        /// Largest addition to it, s.
        jitter_s: f64,
    },
    /// Each frame is duplicated with a probability.
    Duplicates {
        /// Probability, 0..1.
        share: f64,
        /// Delay of the copy, s.
        after_s: f64,
    },
    /// A byte of each frame is changed with a probability.
    Corruption {
        /// Probability, 0..1.
        share: f64,
    },
    /// Earlier frames from the vehicle are repeated, most of them its mode.
    Replay {
        /// Their age, s.
        age_s: f64,
        /// Repeated frames a second, Hz.
        rate_hz: f64,
    },
    /// Another system with its own autopilot is on the link.
    Foreign {
        /// Its system id.
        system: u8,
    },
    /// Someone else sends setpoints to the vehicle.
    Injected {
        /// Thrust field, 0..1.
        thrust: f64,
        /// Pitch, rad.
        pitch_rad: f64,
    },
    /// The stamps of the vehicle's clock are off by a constant.
    ClockStep {
        /// Offset, s.
        by_s: f64,
    },
    /// 32-bit stamps wrap at 12 s, whatever the time of the fault.
    ClockWrap,
    /// The vehicle repeats one state under new stamps.
    Freeze,
    /// The vehicle reports a wrong position.
    Jump {
        /// Step to the north, m; half of it to the east.
        metres: f64,
        /// Whether the vehicle reports a reset of its estimate.
        is_told: bool,
    },
    /// The state contains NaN.
    NotANumber,
    /// The state carries earlier stamps.
    OldStamps {
        /// Age of the stamps, s.
        by_s: f64,
    },
    /// ODOMETRY uses another frame.
    OtherFrame,
    /// A rotor loses a share of its thrust, for good.
    Rotor {
        /// The rotor.
        index: usize,
        /// Lost share of its thrust, 0..1.
        loss: f64,
    },
    /// The pack's charge drops to a value.
    Battery {
        /// The charge, 0..1.
        charge: f64,
    },
    /// A lasting force on the vehicle, as from a step of the wind.
    Wind {
        /// Share of the vehicle's weight.
        share: f64,
        /// Direction, rad from north.
        towards_rad: f64,
    },
    /// A load is dropped.
    Dropped {
        /// Its share of the weight, 0..1.
        share: f64,
    },
    /// The vehicle restarts: it is disarmed at its starting place.
    Reboot,
    /// The vehicle refuses commands.
    Refusals,
    /// The pilot acts.
    Pilot {
        /// The act.
        act: PilotAct,
    },
    /// The controller's process is stopped.
    Pause,
    /// The controller's process is killed, and restarted at the end of this fault.
    Restart,
    /// The transport takes no frames.
    Jammed,
    /// Nothing takes the records: the disk is full, or a viewer is too slow.
    LogStuck,
    /// The planner repeats its answer from the start of this fault.
    PlannerStalls,
    /// The planner answers with a wrong place.
    PlannerLies {
        /// Size of the error, m.
        metres: f64,
    },
    /// The planner answers with NaN.
    PlannerFails,
}

impl Fault {
    /// The name in a script.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Loss { .. } => "loss",
            Self::Cut { .. } => "cut",
            Self::ModeLost => "mode_lost",
            Self::Delay { .. } => "delay",
            Self::Duplicates { .. } => "duplicates",
            Self::Corruption { .. } => "corruption",
            Self::Replay { .. } => "replay",
            Self::Foreign { .. } => "foreign",
            Self::Injected { .. } => "injected",
            Self::ClockStep { .. } => "clock_step",
            Self::ClockWrap => "clock_wrap",
            Self::Freeze => "freeze",
            Self::Jump { .. } => "jump",
            Self::NotANumber => "not_a_number",
            Self::OldStamps { .. } => "old_stamps",
            Self::OtherFrame => "other_frame",
            Self::Rotor { .. } => "rotor",
            Self::Battery { .. } => "battery",
            Self::Wind { .. } => "wind",
            Self::Dropped { .. } => "dropped",
            Self::Reboot => "reboot",
            Self::Refusals => "refusals",
            Self::Pilot { .. } => "pilot",
            Self::Pause => "pause",
            Self::Restart => "restart",
            Self::Jammed => "jammed",
            Self::LogStuck => "log_stuck",
            Self::PlannerStalls => "planner_stalls",
            Self::PlannerLies { .. } => "planner_lies",
            Self::PlannerFails => "planner_fails",
        }
    }
}

impl Timed {
    /// Whether the fault acts at `now_us`.
    pub fn acts(&self, now_us: u64) -> bool {
        let now_s = now_us as f64 * 1e-6;
        (self.at_s..self.at_s + self.for_s).contains(&now_s)
    }

    /// Whether the fault begins from `from_us` on and before `to_us`.
    pub fn begins(&self, from_us: u64, to_us: u64) -> bool {
        let at_us = self.at_us();
        from_us <= at_us && at_us < to_us
    }

    /// Begin of the fault, us.
    pub fn at_us(&self) -> u64 {
        (self.at_s * 1e6).round() as u64
    }

    /// End of the fault, us.
    pub fn end_us(&self) -> u64 {
        ((self.at_s + self.for_s) * 1e6).round() as u64
    }
}

/// Why a script is rejected.
#[derive(Debug, thiserror::Error)]
pub enum ScriptError {
    /// The text is not JSON or TOML of this format.
    #[error("fault script: {0}")]
    Syntax(String),
    /// A value is impossible.
    #[error("fault script: {field}: expected {expected}, found {found}")]
    Value {
        /// The field.
        field: &'static str,
        /// What would be valid.
        expected: &'static str,
        /// The value in the script.
        found: String,
    },
}

impl Script {
    /// Parses a script from JSON or TOML.
    ///
    /// # Errors
    /// [`ScriptError`].
    pub fn parse(text: &str) -> Result<Self, ScriptError> {
        let script: Self = if text.trim_start().starts_with('{') {
            serde_json::from_str(text).map_err(|error| ScriptError::Syntax(error.to_string()))?
        } else {
            vehicle::from_toml(text).map_err(|error| ScriptError::Syntax(error.to_string()))?
        };
        script.check()?;
        Ok(script)
    }

    /// The next begin or end of a fault after `now_us`, us.
    pub(super) fn next_change_us(&self, now_us: u64) -> u64 {
        let times = self.faults.iter().flat_map(|timed| [timed.at_us(), timed.end_us()]);
        times.filter(|at| *at > now_us).min().unwrap_or(u64::MAX)
    }

    fn check(&self) -> Result<(), ScriptError> {
        let refuse = |field, expected, found: String| ScriptError::Value { field, expected, found };
        if self.schema_version != VERSION {
            let found = self.schema_version.to_string();
            return Err(refuse("schema_version", "1", found));
        }
        if !(0.5..=2.0).contains(&self.clock_rate) {
            return Err(refuse("clock_rate", "0.5 to 2", self.clock_rate.to_string()));
        }
        let is_time = |s: f64| (0.0..=3600.0).contains(&s);
        if let Some(wrong) = self.faults.iter().find(|it| !is_time(it.at_s) || !is_time(it.for_s)) {
            let found = format!("{wrong:?}");
            return Err(refuse("faults", "times in 0 to 3600 s", found));
        }
        if self.faults.iter().any(|it| matches!(it.fault, Fault::Rotor { index, .. } if index > 3))
        {
            return Err(refuse("faults", "a rotor of 0 to 3", "another".to_owned()));
        }
        Ok(())
    }
}
