//! Conditions of a case beside its vehicle and its truth: the quality of the vehicle file, the loop
//! on board, and the imperfections of real logs.

use mavlink::MessageData;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use sitl::autopilot::SYSTEM_ID;
use sitl::config::{EstimatorConfig, Vibration};
use vehicle::{AttitudeCascade, AttitudePd, VehicleParams};

use wire::dialect::{HEARTBEAT_DATA, SET_ATTITUDE_TARGET_DATA};

use super::airframe;
use super::condition::rewritten;
use super::draw::{Draw, rounded};
use super::flight::Link;

/// Stream of a flight's seed that selects the lost frames.
const LOSS: u64 = 0x105e;

/// The kind of vehicles that an exam flies.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum World {
    /// Vehicles that match their files, with the bundled loop: only the effect and noise differ.
    #[default]
    Exact,
    /// Vehicles that differ from their files like builders' do.
    Builders,
}

/// The quality of a vehicle file.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, JsonSchema, Serialize, Deserialize,
)]
#[serde(rename_all = "kebab-case")]
pub enum FileKind {
    /// Every number matches the vehicle.
    Exact,
    /// Off by a builder's tolerances, which the file states.
    Claimed,
    /// Off by a builder's tolerances, which the file does not state.
    Unclaimed,
}

/// The loop on board, and what the log shows of it.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, JsonSchema, Serialize, Deserialize,
)]
#[serde(rename_all = "kebab-case")]
pub enum LoopKind {
    /// A PD loop that the file states.
    Pd,
    /// A cascade that the file does not state; setpoints are logged.
    Cascade,
    /// The same cascade without logged setpoints.
    CascadeUnlogged,
}

/// Shares of the kinds of files and of loops.
const FILES: [(FileKind, f64); 3] =
    [(FileKind::Exact, 0.2), (FileKind::Claimed, 0.6), (FileKind::Unclaimed, 0.2)];
const LOOPS: [(LoopKind, f64); 3] =
    [(LoopKind::Pd, 0.5), (LoopKind::Cascade, 0.3), (LoopKind::CascadeUnlogged, 0.2)];
/// Rates of the logged outputs, Hz, with their shares.
const OUTPUTS_HZ: [(f64, f64); 4] = [(250.0, 0.1), (100.0, 0.45), (50.0, 0.3), (10.0, 0.15)];
/// Shares of cases with each of the other nuisances.
const VIBRATION: f64 = 0.25;
const WANDER: f64 = 0.3;
const DRIFT: f64 = 0.2;
const LOST: f64 = 0.25;
const ROUGH_LINK: f64 = 0.2;

impl FileKind {
    /// Its name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Exact => "exact",
            Self::Claimed => "off, claimed",
            Self::Unclaimed => "off, not claimed",
        }
    }
}

impl LoopKind {
    /// Its name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Pd => "PD",
            Self::Cascade => "cascade",
            Self::CascadeUnlogged => "cascade, no setpoints",
        }
    }

    /// Whether the diagnosis knows the loop.
    pub fn is_known(self) -> bool {
        self == Self::Pd
    }
}

/// The conditions of a case.
#[derive(Clone, Debug, PartialEq)]
pub struct Setting {
    /// Quality of the vehicle file.
    pub file: FileKind,
    /// The loop on board.
    pub on_board: LoopKind,
    /// Rate of the logged outputs, Hz.
    pub outputs_hz: f64,
    /// Spectral lines of the rotors in the inertial unit.
    pub vibration: Vibration,
    /// Wander of the state estimate.
    pub estimator: EstimatorConfig,
    /// Correlation time of the attitude's error, s.
    pub attitude_correlation_s: Option<f64>,
    /// Relative rate error of the ground's clock; `None` for a good one.
    pub drift: Option<f64>,
    /// Mean delay of the link beyond the least, s; `None` for a good one.
    pub jitter_s: Option<f64>,
    /// Share of the vehicle's frames that the log lacks.
    pub lost: f64,
}

impl Setting {
    /// The conditions of [`World::Exact`].
    pub fn exact(outputs_hz: f64) -> Self {
        Self {
            file: FileKind::Exact,
            on_board: LoopKind::Pd,
            outputs_hz,
            vibration: Vibration::default(),
            estimator: EstimatorConfig::default(),
            attitude_correlation_s: None,
            drift: None,
            jitter_s: None,
            lost: 0.0,
        }
    }

    /// Draws conditions of [`World::Builders`], for rotors with this frequency at full speed, Hz.
    pub fn draw(draw: &mut Draw, rotor_max_hz: f64) -> Self {
        let (file, on_board) = (draw.one_of(&FILES), draw.one_of(&LOOPS));
        let outputs_hz = draw.one_of(&OUTPUTS_HZ);
        let mut setting = Self { file, on_board, ..Self::exact(outputs_hz) };
        if draw.chance(VIBRATION) {
            setting.vibration = Vibration {
                rotor_max_hz: rounded(rotor_max_hz),
                gyro_rad_s: rounded(draw.log_within([0.003, 0.03])),
                accelerometer_m_s2: rounded(draw.log_within([0.2, 2.0])),
            };
        }
        if draw.chance(WANDER) {
            // Error of the estimated velocity, whatever the position.
            let velocity_m_s = draw.log_within([0.01, 0.1]);
            let wander_time_s = rounded(draw.within([2.0, 6.0]));
            setting.estimator.wander_time_s = wander_time_s;
            setting.estimator.wander_m = rounded(velocity_m_s * wander_time_s);
            setting.attitude_correlation_s = Some(rounded(draw.log_within([0.05, 2.0])));
        }
        setting.drift =
            draw.chance(DRIFT).then(|| rounded(draw.sign() * draw.log_within([2e-4, 8e-3])));
        setting.jitter_s = draw.chance(ROUGH_LINK).then(|| rounded(draw.within([2e-3, 6e-3])));
        if draw.chance(LOST) {
            setting.lost = rounded(draw.log_within([0.01, 0.1]));
        }
        setting
    }

    /// The link `good`, with these conditions.
    pub fn link(&self, good: Link) -> Link {
        Link {
            skew: self.drift.unwrap_or(good.skew),
            jitter_s: self.jitter_s.unwrap_or(good.jitter_s),
            ..good
        }
    }

    /// The log under these conditions: without lost frames, and without setpoints where none are
    /// logged. Heartbeats stay.
    pub fn logged(&self, log: Vec<u8>, seed: u64) -> Vec<u8> {
        let is_unlogged = self.on_board == LoopKind::CascadeUnlogged;
        if self.lost == 0.0 && !is_unlogged {
            return log;
        }
        let mut draw = Draw::new(seed, LOSS);
        rewritten(&log, |frame| {
            let is_lost = draw.chance(self.lost) && frame.system() == u32::from(SYSTEM_ID);
            let is_hidden = is_unlogged && frame.id() == SET_ATTITUDE_TARGET_DATA::ID;
            let is_heartbeat = frame.id() == HEARTBEAT_DATA::ID;
            (is_heartbeat || !is_lost && !is_hidden).then_some(0)
        })
    }

    /// Notes on every imperfection of the log.
    pub fn notes(&self) -> Vec<String> {
        let mut notes = Vec::new();
        let mut note = |holds: bool, what: String| notes.extend(holds.then_some(what));
        note(self.outputs_hz < 100.0, format!("outputs at {} Hz", self.outputs_hz));
        note(self.vibration.rotor_max_hz > 0.0, "vibration".to_owned());
        note(self.estimator.wander_m > 0.0, "estimator wanders".to_owned());
        note(self.drift.is_some(), "clocks drift".to_owned());
        note(self.jitter_s.is_some(), "rough link".to_owned());
        note(self.lost > 0.0, "frames lost".to_owned());
        notes
    }
}

/// Ratio of a cascade's attitude bandwidth to the PD's, and of its rate gain: the filters and the
/// integral use up margin that the rotors' lag leaves.
const ANGLE_SHARE: f64 = 0.6;
const RATE_SHARE: f64 = 0.85;

/// A cascade with the PD's proportions: an attitude loop around a rate loop with an integral,
/// behind filters.
pub fn cascade(draw: &mut Draw, vehicle: &VehicleParams, pd: &AttitudePd) -> AttitudeCascade {
    let arm = airframe::arm_m(vehicle);
    // The moment of half of the weight on one side.
    let tilting = 0.25 * vehicle.mass * vehicle.gravity * arm;
    let turning =
        0.25 * vehicle.mass * vehicle.gravity * vehicle.rotors[0].drag_torque_per_thrust_m;
    let rate_p_nms = pd.kd.map(|kd| rounded(RATE_SHARE * kd));
    let angle = |axis: usize| rounded(ANGLE_SHARE * pd.kp[axis] / pd.kd[axis].max(1e-12));
    let integral_per_s = draw.within([0.5, 1.5]);
    let derivative_s = draw.within([0.005, 0.02]);
    AttitudeCascade {
        angle_p_per_s: std::array::from_fn(angle),
        rate_max_rad_s: [rounded(draw.within([3.5, 6.0])), 3.8, 3.5],
        rate_p_nms,
        rate_i_nm: rate_p_nms.map(|p| rounded(integral_per_s * p)),
        rate_d_nms2: [
            rounded(derivative_s * rate_p_nms[0]),
            rounded(derivative_s * rate_p_nms[1]),
            0.0,
        ],
        rate_ff_nms: [0.0; 3],
        integral_max_nm: [tilting, tilting, turning].map(rounded),
        gyro_cutoff_hz: rounded(draw.within([40.0, 90.0])),
        derivative_cutoff_hz: rounded(draw.within([20.0, 50.0])),
        input_time_constant_s: None,
        rate_hz: draw.one_of(&[(250.0, 0.4), (400.0, 0.3), (500.0, 0.3)]),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn drawn_shares_match_the_stated_ones() {
        let drawn: Vec<Setting> =
            (0..2000).map(|number| Setting::draw(&mut Draw::new(2, number), 150.0)).collect();
        let share = |is: &dyn Fn(&Setting) -> bool| {
            drawn.iter().filter(|setting| is(setting)).count() as f64 / drawn.len() as f64
        };
        let near = |share: f64, expected: f64| (share - expected).abs() < 0.04;
        for (file, expected) in FILES {
            assert!(near(share(&|setting| setting.file == file), expected), "{file:?}");
        }
        for (on_board, expected) in LOOPS {
            assert!(near(share(&|setting| setting.on_board == on_board), expected), "{on_board:?}");
        }
        for (hz, expected) in OUTPUTS_HZ {
            assert!(near(share(&|setting| setting.outputs_hz == hz), expected), "{hz}");
        }
        assert!(near(share(&|setting| setting.lost > 0.0), LOST));
        assert!(near(share(&|setting| setting.vibration.gyro_rad_s > 0.0), VIBRATION));
        assert!(near(share(&|setting| setting.estimator.wander_m > 0.0), WANDER));
        assert!(near(share(&|setting| setting.drift.is_some()), DRIFT));
    }
}
