//! A flight and its faults as data: what a campaign draws, shrinks, and plays again.

use serde::{Deserialize, Serialize};
use sitl::config::Autopilot;

use crate::supervisor::EngagePolicy;

/// Version of the form.
pub const VERSION: u32 = 1;

/// A flight with faults. The same script gives the same flight, to the byte.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Script {
    /// [`VERSION`].
    pub schema_version: u32,
    /// Seed of noise, delays and gusts, and of what the faults draw on the way.
    pub seed: u64,
    /// A shipped vehicle.
    pub vehicle: String,
    /// Whose manners the simulated vehicle has.
    pub autopilot: Autopilot,
    /// The id of the control law.
    pub law: String,
    /// Who decides that the flight begins: a command, or the pilot's switch.
    pub policy: EngagePolicy,
    /// Seconds of the vehicle's clock in one of the host's.
    pub clock_rate: f64,
    /// Whether both ends sign what they say (MAVLink 2), and believe nothing else.
    #[serde(default)]
    pub signed: bool,
    /// The trajectory, as the text of its file.
    pub trajectory: String,
    /// What happens on the way.
    pub faults: Vec<Timed>,
}

/// A fault and when it acts.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Timed {
    /// From which simulated time on, s.
    pub at_s: f64,
    /// For how long, s; what happens in an instant has none.
    pub for_s: f64,
    /// What.
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
    /// Both.
    Both,
}

impl Way {
    /// Whether it is from the vehicle.
    pub fn is_down(self) -> bool {
        self != Self::Up
    }

    /// Whether it is to the vehicle.
    pub fn is_up(self) -> bool {
        self != Self::Down
    }
}

/// What the pilot asks of the vehicle with his own ground station.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PilotAct {
    /// Position hold.
    Position,
    /// The mode that stays.
    Hold,
    /// The way home.
    Return,
    /// Landing.
    Land,
    /// The mode in which setpoints are obeyed.
    Offboard,
    /// Arming.
    Arm,
    /// Disarming, which the vehicle refuses in the air.
    Disarm,
    /// Motors off, in the air too.
    Kill,
}

/// What goes wrong.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum Fault {
    /// Each frame is lost with a probability.
    Loss {
        /// Which frames.
        way: Way,
        /// 0..1
        share: f64,
    },
    /// No frame passes.
    Cut {
        /// Which frames.
        way: Way,
    },
    /// Frames of the mode (HEARTBEAT, CURRENT_MODE) do not arrive.
    ModeLost,
    /// Frames come later, each by its own delay: with jitter they overtake one another.
    Delay {
        /// Which frames.
        way: Way,
        /// At least, s.
        least_s: f64,
        /// More than that by up to, s.
        jitter_s: f64,
    },
    /// Each frame comes twice with a probability.
    Duplicates {
        /// 0..1
        share: f64,
        /// The copy comes later by this, s.
        after_s: f64,
    },
    /// A byte of each frame is changed with a probability.
    Corruption {
        /// 0..1
        share: f64,
    },
    /// Frames of the vehicle that were heard a while ago come again, most of them of its mode.
    Replay {
        /// How old they are, s.
        age_s: f64,
        /// How many in a second.
        rate_hz: f64,
    },
    /// Another system, with an autopilot of its own, is on the link.
    Foreign {
        /// Its system id.
        system: u8,
    },
    /// Somebody else sends the vehicle setpoints.
    Injected {
        /// Thrust field.
        thrust: f64,
        /// rad
        pitch_rad: f64,
    },
    /// The stamps of the vehicle's clock are off by this.
    ClockStep {
        /// s
        by_s: f64,
    },
    /// Stamps of 32 bits wrap at 12 s; at no time in particular.
    ClockWrap,
    /// The vehicle repeats one state under new stamps.
    Freeze,
    /// The vehicle reports a wrong position.
    Jump {
        /// North, m; half of it east.
        metres: f64,
        /// Whether the vehicle reports that it reset its estimate.
        is_told: bool,
    },
    /// The state holds NaN.
    NotANumber,
    /// The state comes with the stamps of a while ago.
    OldStamps {
        /// s
        by_s: f64,
    },
    /// ODOMETRY comes in another frame.
    OtherFrame,
    /// A rotor loses a share of its thrust, for good.
    Rotor {
        /// Which.
        index: usize,
        /// 0..1
        loss: f64,
    },
    /// The pack is down to this charge.
    Battery {
        /// 0..1
        charge: f64,
    },
    /// A force on the vehicle from now on, as by a step of the wind.
    Wind {
        /// Share of its weight.
        share: f64,
        /// Where to, rad from north.
        towards_rad: f64,
    },
    /// A load is dropped: a share of the weight less.
    Dropped {
        /// 0..1
        share: f64,
    },
    /// The vehicle is started again: it stands disarmed where it began.
    Reboot,
    /// The vehicle denies commands.
    Refusals,
    /// The pilot does something.
    Pilot {
        /// What.
        act: PilotAct,
    },
    /// The daemon's process is stopped.
    Pause,
    /// The daemon's process is killed, and started again after this fault's time.
    Restart,
    /// The transport takes no frames.
    Jammed,
    /// Nobody takes the records: no room for the log, or a viewer that is too slow.
    LogStuck,
    /// The planner answers with what it said when this began.
    PlannerStalls,
    /// The planner answers with a place that is this far off.
    PlannerLies {
        /// m
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
    /// Whether it acts at `now_us`.
    pub fn acts(&self, now_us: u64) -> bool {
        let now_s = now_us as f64 * 1e-6;
        (self.at_s..self.at_s + self.for_s).contains(&now_s)
    }

    /// Whether it begins in the time from `from_us` on, before `to_us`.
    pub fn begins(&self, from_us: u64, to_us: u64) -> bool {
        let at_us = self.at_us();
        from_us <= at_us && at_us < to_us
    }

    /// When it begins, us.
    pub fn at_us(&self) -> u64 {
        (self.at_s * 1e6).round() as u64
    }

    /// When it is over, us.
    pub fn end_us(&self) -> u64 {
        ((self.at_s + self.for_s) * 1e6).round() as u64
    }
}

/// Why a script is refused.
#[derive(Debug, thiserror::Error)]
pub enum ScriptError {
    /// Not JSON or TOML of this form.
    #[error("fault script: {0}")]
    Syntax(String),
    /// A value that cannot be.
    #[error("fault script: {field}: expected {expected}, found {found}")]
    Value {
        /// Which.
        field: &'static str,
        /// What would be right.
        expected: &'static str,
        /// What is there.
        found: String,
    },
}

impl Script {
    /// A script's text, JSON or TOML.
    ///
    /// # Errors
    /// [`ScriptError`].
    pub fn parse(text: &str) -> Result<Self, ScriptError> {
        let script: Self = if text.trim_start().starts_with('{') {
            serde_json::from_str(text).map_err(|error| ScriptError::Syntax(error.to_string()))?
        } else {
            toml::from_str(text).map_err(|error| ScriptError::Syntax(error.to_string()))?
        };
        script.check()?;
        Ok(script)
    }

    /// When the next fault begins or ends after `now_us`, us.
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
