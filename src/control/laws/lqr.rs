//! The yaw-rotated linear quadratic regulator.

use nalgebra::{SMatrix, SVector};
use vehicle::frame::{Euler, Frd, Heading};
use vehicle::rigid_body::State;

use super::super::actuation::{Actuation, DELAYED_STATES, DelayedModel};
use super::super::attitude_loop::{AttitudeLoop, angle_error};
use super::super::disturbance::Use;
use super::super::hover_model::{HoverModel, HoverVehicle, INPUTS, STATES};
use super::super::output_feedback::OutputFeedback;
use super::super::riccati::{solve_dare, spectral_radius};
use super::{
    Command, ControlLaw, ControlProblem, ControlSettings, DesignError, Gain, LawSpec, Reach,
};
use crate::setpoint::{Reference, Setpoint};

/// The LQR in the table of laws.
pub(super) static SPEC: LawSpec = LawSpec {
    id: "lqr",
    summary: "The paper's LQR about hover, its horizontal errors turned by yaw.",
    gains: &[
        gain("position_m", "m", 3, "acceptable position error"),
        gain("velocity_m_s", "m/s", 3, "acceptable velocity error"),
        gain("attitude_rad", "rad", 3, "acceptable error of roll, pitch and yaw"),
        gain("body_rate_rad_s", "rad/s", 3, "acceptable error of the body rate"),
        gain("thrust", "hover thrusts", 1, "acceptable thrust correction"),
        gain("attitude_command_rad", "rad", 3, "acceptable correction of the attitude setpoint"),
        gain("body_rate_command_rad_s", "rad/s", 3, "acceptable correction of the rate setpoint"),
    ],
    design: |problem| Ok(Box::new(Lqr::for_problem(problem)?)),
};

const fn gain(key: &'static str, unit: &'static str, values: usize, meaning: &'static str) -> Gain {
    Gain { key, unit, values, meaning }
}

/// Errors that the gain is optimised for where lag and delay leave a choice: north, east, down;
/// velocity; roll, pitch, yaw; body rate, in SI units. Typical of an approach and of a gust.
const ERRORS: [f64; STATES] = [0.3, 0.3, 0.3, 0.3, 0.3, 0.3, 0.1, 0.1, 0.1, 0.5, 0.5, 0.5];
/// Most attempts at a gain that settles the loop, each weaker than the last.
const ATTEMPTS: usize = 24;
/// Factor of the roll and pitch corrections per step of quickening, and the most steps.
const QUICKENED: f64 = 1.15;
const QUICKENINGS: usize = 20;
/// Indices of inputs.
const ROLL: usize = 1;
const PITCH: usize = 2;

type Late = OutputFeedback<DELAYED_STATES, INPUTS>;

/// The feedback law `u_hat = u_hat* + K T_R (s - s*)`.
#[derive(Clone, Debug)]
pub struct Lqr {
    attitude_loop: AttitudeLoop,
    gain: SMatrix<f64, INPUTS, STATES>,
    spectral_radius: f64,
    reach: Reach,
}

impl Lqr {
    /// Designs the gain for a vehicle: [`Lqr::design_for`] with the problem's data.
    ///
    /// # Errors
    /// As [`Lqr::design_for`].
    pub fn for_problem(problem: &ControlProblem) -> Result<Self, DesignError> {
        let ControlProblem { vehicle, actuation, attitude_loop, settings, .. } = problem;
        Self::design_for(actuation, vehicle, attitude_loop, settings)
    }

    /// Designs the gain on the near-hover model of `vehicle` with `attitude_loop` inside, without
    /// delay or lag.
    ///
    /// # Errors
    /// [`DesignError`] if a number of the vehicle or the settings is not positive, or no
    /// stabilising gain exists.
    pub fn design(
        vehicle: &HoverVehicle,
        attitude_loop: &AttitudeLoop,
        settings: &ControlSettings,
    ) -> Result<Self, DesignError> {
        check(vehicle, attitude_loop, settings)?;
        let model =
            HoverModel::continuous(vehicle, attitude_loop).discretised(1.0 / settings.rate_hz);
        let (q, r) = settings.weights(vehicle.hover_thrust_n());
        let solution = solve_dare(&model.state, &model.input, &q, &r)?;
        Ok(Self {
            attitude_loop: *attitude_loop,
            gain: -solution.gain,
            spectral_radius: solution.spectral_radius,
            reach: settings.into(),
        })
    }

    /// Designs the gain for a vehicle with known delay and lag. Delayed setpoints and the rotors'
    /// moments are unmeasured states, so the design takes the optimal gain `K` on the measured
    /// states under the same weights. It approaches that of [`Lqr::design`] as delay and lag go to
    /// zero; the slower the vehicle, the lower the gains, attitude feedback first.
    ///
    /// Where [`ControlSettings::quicken`] is on, the gain then corrects roll and pitch by more than
    /// the acceptable corrections in the settings, as far as [`ControlSettings::margin_min`]
    /// allows.
    ///
    /// # Errors
    /// As [`Lqr::design`], and [`DesignError::TooSlow`].
    pub fn design_for(
        actuation: &Actuation,
        vehicle: &HoverVehicle,
        attitude_loop: &AttitudeLoop,
        settings: &ControlSettings,
    ) -> Result<Self, DesignError> {
        let prompt = Self::design(vehicle, attitude_loop, settings)?;
        if *actuation == Actuation::IMMEDIATE {
            return Ok(prompt);
        }
        let hover = HoverModel::continuous(vehicle, attitude_loop);
        let model = DelayedModel::new(&hover, attitude_loop, actuation, 1.0 / settings.rate_hz);
        let mut problem = late_problem(&model, settings, vehicle.hover_thrust_n());
        let mut gain = settled(&problem, prompt.gain).ok_or(DesignError::TooSlow {
            delay_s: actuation.command_delay_s,
            lag_s: actuation.motor_time_constant_s,
        })?;
        if settings.quicken == Use::On {
            let mut quicker = settings.clone();
            for _ in 0..QUICKENINGS {
                for correction in &mut quicker.attitude_command_rad[..2] {
                    *correction *= QUICKENED;
                }
                problem = late_problem(&model, &quicker, vehicle.hover_thrust_n());
                let Some(candidate) = problem.improve(gain) else { break };
                let margin = [ROLL, PITCH].map(|input| problem.margin(&candidate, input));
                if margin.into_iter().any(|margin| margin < settings.margin_min) {
                    break;
                }
                gain = candidate;
            }
        }
        let mut closed_loop = model.state;
        let mut columns = closed_loop.fixed_view_mut::<DELAYED_STATES, STATES>(0, 0);
        columns += model.input * gain;
        Ok(Self { gain, spectral_radius: spectral_radius(&closed_loop), ..prompt })
    }

    /// `K`, the negative of SciPy's and MATLAB's: rows thrust, (roll, pitch, yaw), body rate;
    /// columns position, velocity, (roll, pitch, yaw), body rate.
    pub fn gain(&self) -> &SMatrix<f64, INPUTS, STATES> {
        &self.gain
    }

    /// Stiffness and damping of the position under the feedback, with the attitude loop inside:
    /// `dv/dt = -stiffness e - damping v` along north, east and down, 1/s^2 and 1/s. The attitude
    /// is taken to have settled (its states' derivatives are set to 0 and eliminated), so these
    /// describe the slow part of the closed loop.
    pub fn translational(&self, vehicle: &HoverVehicle) -> ([f64; 3], [f64; 3]) {
        const MOVES: usize = 6;
        let hover = HoverModel::continuous(vehicle, &self.attitude_loop);
        let closed_loop = hover.state + hover.input * self.gain;
        let block = |row, column| closed_loop.fixed_view::<MOVES, MOVES>(row, column).into_owned();
        let settled = block(MOVES, MOVES).lu().solve(&block(MOVES, 0)).unwrap_or_default();
        let slow = block(0, 0) - block(0, MOVES) * settled;
        let gain = |column| std::array::from_fn(|i| -slow[(3 + i, column + i)]);
        (gain(0), gain(3))
    }

    /// The attitude loop in the design model.
    pub fn attitude_loop(&self) -> &AttitudeLoop {
        &self.attitude_loop
    }

    /// Spectral radius of the linear closed loop.
    pub fn spectral_radius(&self) -> f64 {
        self.spectral_radius
    }

    /// The correction `K T_R (s - s*)` to the reference's input, and whether its position error was
    /// cut. `T_R` turns the horizontal errors of position and velocity by the present yaw (Bansal
    /// et al., eq. 11-13); the yaw error is wrapped.
    pub fn feedback(&self, state: &State, reference: &Reference) -> (Setpoint, bool) {
        let attitude = state.attitude.euler();
        let (error, is_cut) = self.reach.bounded(state.position - reference.position);
        let heading = Heading::new(attitude.yaw);
        let [pn, pe, pd] = heading.to_level(error);
        let [vn, ve, vd] = heading.to_level(state.velocity - reference.velocity);
        let [roll, pitch, yaw] = angle_error(attitude, reference.attitude);
        let [p, q, r] = (state.body_rate - reference.body_rate).to_array();
        let error = SVector::from([pn, pe, pd, vn, ve, vd, roll, pitch, yaw, p, q, r]);
        let [thrust_n, roll, pitch, yaw, p, q, r] = (self.gain * error).into();
        let correction = Setpoint {
            thrust_n,
            attitude: Euler::new(roll, pitch, yaw),
            body_rate: Frd::new(p, q, r),
        };
        (correction, is_cut)
    }
}

/// The output feedback problem of a vehicle with delay and lag.
fn late_problem(model: &DelayedModel, settings: &ControlSettings, hover_thrust_n: f64) -> Late {
    let (q, r) = settings.weights(hover_thrust_n);
    let mut problem = OutputFeedback {
        state: model.state,
        input: model.input,
        state_weight: SMatrix::zeros(),
        input_weight: r,
        errors: SMatrix::zeros(),
    };
    problem.state_weight.fixed_view_mut::<STATES, STATES>(0, 0).copy_from(&q);
    for (i, error) in ERRORS.into_iter().enumerate() {
        problem.errors[(i, i)] = error * error;
    }
    problem
}

/// The optimal gain, started from `start` or the first weaker gain that settles the loop.
fn settled(
    problem: &Late,
    mut start: SMatrix<f64, INPUTS, STATES>,
) -> Option<SMatrix<f64, INPUTS, STATES>> {
    for _ in 0..ATTEMPTS {
        if let Some(gain) = problem.improve(start) {
            return Some(gain);
        }
        // Slower each time: position scales by the square of velocity, which keeps the damping
        // ratio.
        for (columns, factor) in [(0, 0.64), (3, 0.8), (6, 0.5), (9, 0.5)] {
            start.fixed_columns_mut::<3>(columns).scale_mut(factor);
        }
    }
    None
}

impl ControlLaw for Lqr {
    fn command(&mut self, state: &State, reference: &Reference, _dt_s: f64) -> Command {
        let (feedback, is_cut) = self.feedback(state, reference);
        Command::correcting(reference, feedback, is_cut)
    }
}

impl ControlSettings {
    /// The diagonal `Q` and `R`, in SI, for a vehicle whose hover thrust is `hover_thrust_n`.
    pub fn weights(
        &self,
        hover_thrust_n: f64,
    ) -> (SMatrix<f64, STATES, STATES>, SMatrix<f64, INPUTS, INPUTS>) {
        let weight = |deviation: f64| 1.0 / (deviation * deviation);
        let states = [self.position_m, self.velocity_m_s, self.attitude_rad, self.body_rate_rad_s];
        let q = SVector::<f64, STATES>::from_iterator(states.into_iter().flatten().map(weight));
        let thrust = [self.thrust * hover_thrust_n];
        let commands = self.attitude_command_rad.into_iter().chain(self.body_rate_command_rad_s);
        let r =
            SVector::<f64, INPUTS>::from_iterator(thrust.into_iter().chain(commands).map(weight));
        (SMatrix::from_diagonal(&q), SMatrix::from_diagonal(&r))
    }
}

fn check(
    vehicle: &HoverVehicle,
    attitude_loop: &AttitudeLoop,
    settings: &ControlSettings,
) -> Result<(), DesignError> {
    let loop_numbers = match attitude_loop {
        AttitudeLoop::Pd { kp, kd } | AttitudeLoop::AttitudePd { kp, kd } => {
            [("attitude gain kp", kp), ("attitude gain kd", kd)]
        }
        AttitudeLoop::RatePd { gain, kd } => [("attitude gain", gain), ("attitude gain kd", kd)],
        AttitudeLoop::Attitude { natural_frequency, damping } => {
            [("natural frequency", natural_frequency), ("damping", damping)]
        }
        AttitudeLoop::Rates { gain, time_constant_s } => {
            [("attitude gain", gain), ("rate loop time constant", time_constant_s)]
        }
    };
    let triples = [
        ("inertia", &vehicle.inertia),
        ("acceptable position error", &settings.position_m),
        ("acceptable velocity error", &settings.velocity_m_s),
        ("acceptable attitude error", &settings.attitude_rad),
        ("acceptable body rate error", &settings.body_rate_rad_s),
        ("acceptable attitude command", &settings.attitude_command_rad),
        ("acceptable body rate command", &settings.body_rate_command_rad_s),
    ];
    let singles = [
        ("mass", vehicle.mass_kg),
        ("gravity", vehicle.gravity),
        ("feedback rate", settings.rate_hz),
        ("acceptable thrust correction", settings.thrust),
        ("largest horizontal error", settings.horizontal_error_max_m),
        ("largest vertical error", settings.vertical_error_max_m),
        ("margin of the loop", settings.margin_min),
    ];
    let flattened = triples
        .into_iter()
        .chain(loop_numbers)
        .flat_map(|(quantity, values)| values.iter().map(move |&found| (quantity, found)));
    for (quantity, found) in singles.into_iter().chain(flattened) {
        if !(found > 0.0 && found.is_finite()) {
            return Err(DesignError::NotPositive { quantity, found });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::quad::{PD, QUAD};
    use super::*;
    use std::f64::consts::{FRAC_PI_2, PI};
    use vehicle::frame::Ned;

    fn lqr() -> Lqr {
        Lqr::design(&QUAD, &PD, &ControlSettings::default()).expect("a stabilising gain")
    }

    fn at_origin(yaw: f64) -> State {
        State { attitude: Euler::new(0.0, 0.0, yaw).attitude(), ..State::default() }
    }

    fn reference(north: f64, east: f64, down: f64, yaw: f64) -> Reference {
        Reference {
            position: Ned::new(north, east, down),
            attitude: Euler::new(0.0, 0.0, yaw),
            ..Reference::default()
        }
    }

    #[test]
    fn target_ahead_pitches_down_and_target_right_rolls_right() {
        let (ahead, _) = lqr().feedback(&at_origin(0.0), &reference(0.5, 0.0, 0.0, 0.0));
        assert!(ahead.attitude.pitch < -0.1 && ahead.attitude.roll.abs() < 1e-12);
        let (right, _) = lqr().feedback(&at_origin(0.0), &reference(0.0, 0.5, 0.0, 0.0));
        assert!(right.attitude.roll > 0.1 && right.attitude.pitch.abs() < 1e-12);
    }

    #[test]
    fn target_in_the_north_is_on_the_left_when_facing_east() {
        let state = at_origin(FRAC_PI_2);
        let (north, _) = lqr().feedback(&state, &reference(0.5, 0.0, 0.0, FRAC_PI_2));
        assert!(north.attitude.roll < -0.1 && north.attitude.pitch.abs() < 1e-12);
        let (east, _) = lqr().feedback(&state, &reference(0.0, 0.5, 0.0, FRAC_PI_2));
        assert!(east.attitude.pitch < -0.1 && east.attitude.roll.abs() < 1e-12);
    }

    #[test]
    fn target_above_adds_thrust_and_climb_rate_reduces_it() {
        let (above, _) = lqr().feedback(&at_origin(0.0), &reference(0.0, 0.0, -0.2, 0.0));
        assert!(above.thrust_n > 0.5);
        let climbing = State { velocity: Ned::new(0.0, 0.0, -1.0), ..at_origin(0.0) };
        let (climbing, _) = lqr().feedback(&climbing, &reference(0.0, 0.0, 0.0, 0.0));
        assert!(climbing.thrust_n < -0.5);
    }

    #[test]
    fn yaw_error_wraps_the_shorter_way() {
        let (correction, _) =
            lqr().feedback(&at_origin(PI - 0.1), &reference(0.0, 0.0, 0.0, 0.1 - PI));
        assert!(correction.attitude.yaw > 0.0 && correction.attitude.yaw < 0.3);
    }

    #[test]
    fn far_reference_is_clipped_to_the_bound_and_flagged() {
        let (far, is_cut) = lqr().feedback(&at_origin(0.0), &reference(100.0, 0.0, 0.0, 0.0));
        let (bound, _) = lqr().feedback(&at_origin(0.0), &reference(1.0, 0.0, 0.0, 0.0));
        assert!(is_cut);
        assert!((far.attitude.pitch - bound.attitude.pitch).abs() < 1e-12);
    }

    #[test]
    fn zero_error_gives_zero_feedback() {
        let (none, is_cut) = lqr().feedback(&at_origin(1.0), &reference(0.0, 0.0, 0.0, 1.0));
        assert!(none.thrust_n == 0.0 && none.attitude.yaw.abs() < 1e-12 && !is_cut);
    }

    #[test]
    fn every_attitude_loop_yields_a_stable_closed_loop() {
        let rates = AttitudeLoop::Rates { gain: [6.0, 6.0, 3.0], time_constant_s: [0.05; 3] };
        for attitude_loop in [PD, AttitudeLoop::PX4, AttitudeLoop::ARDUCOPTER, rates] {
            for rate_hz in [50.0, 100.0, 500.0] {
                let settings = ControlSettings { rate_hz, ..ControlSettings::default() };
                let lqr = Lqr::design(&QUAD, &attitude_loop, &settings).expect("a gain");
                assert!(lqr.spectral_radius() < 1.0);
            }
        }
        let attitude_only = Lqr::design(&QUAD, &AttitudeLoop::PX4, &ControlSettings::default());
        let rows = attitude_only.expect("a gain").gain().fixed_rows::<3>(4).norm();
        assert_eq!(rows, 0.0, "a loop that ignores rates gets none");
    }

    const NANO: HoverVehicle =
        HoverVehicle { mass_kg: 0.03, inertia: [1.66e-5, 1.66e-5, 2.93e-5], gravity: 9.81 };
    const NANO_KP: [f64; 3] = [4.797e-3, 4.797e-3, 1.875e-3];
    const NANO_KD: [f64; 3] = [5.08e-4, 5.08e-4, 4.22e-4];

    fn slow(command_delay_s: f64, motor_time_constant_s: f64) -> Actuation {
        Actuation { command_delay_s, motor_time_constant_s }
    }

    #[test]
    fn actuation_lag_lowers_the_gain_and_none_keeps_it() {
        let (kp, kd) = (NANO_KP, NANO_KD);
        let settings = ControlSettings::default();
        for attitude_loop in [
            AttitudeLoop::Pd { kp, kd },
            AttitudeLoop::AttitudePd { kp, kd },
            AttitudeLoop::RatePd { gain: [6.0, 6.0, 4.0], kd },
            AttitudeLoop::PX4,
        ] {
            let prompt = Lqr::design(&NANO, &attitude_loop, &settings).expect("a gain");
            let made_for = |actuation| {
                Lqr::design_for(&actuation, &NANO, &attitude_loop, &settings).expect("a gain")
            };
            assert_eq!(made_for(Actuation::IMMEDIATE).gain(), prompt.gain());
            let mut before = prompt.gain()[(2, 0)].abs();
            for actuation in [slow(0.005, 0.04), slow(0.02, 0.06)] {
                let lqr = made_for(actuation);
                assert!(lqr.spectral_radius() < 1.0);
                let gain = lqr.gain()[(2, 0)].abs();
                assert!(gain < before, "{attitude_loop:?} {actuation:?}: {gain} after {before}");
                before = gain;
            }
        }
    }

    #[test]
    fn quickened_loop_tracks_faster_within_its_margin() {
        const SIH: HoverVehicle =
            HoverVehicle { mass_kg: 1.0, inertia: [0.025, 0.025, 0.03], gravity: 9.81 };
        let attitude_loop =
            AttitudeLoop::AttitudePd { kp: [1.7, 1.7, 0.224], kd: [0.424, 0.424, 0.08] };
        let settings = ControlSettings::default();
        let quickened = |quicken, margin_min| {
            let settings = ControlSettings { quicken, margin_min, ..settings.clone() };
            Lqr::design_for(&slow(0.01, 0.05), &SIH, &attitude_loop, &settings).expect("a gain")
        };
        let stiffness = |lqr: &Lqr| lqr.translational(&SIH).0[0];
        let (plain, quick) = (quickened(Use::Off, 0.6), quickened(Use::On, 0.6));
        assert!(stiffness(&quick) > 1.8 * stiffness(&plain), "{}", stiffness(&quick));
        assert!(stiffness(&quick) > stiffness(&quickened(Use::On, 0.7)));
        assert_eq!(quickened(Use::Auto, 0.6).gain(), plain.gain(), "unresolved: gain as set");
        assert_eq!(quickened(Use::On, 0.99).gain(), plain.gain(), "no margin to spare");
        let height = quick.gain()[(0, 2)] / plain.gain()[(0, 2)];
        assert!((height - 1.0).abs() < 0.01, "height as before: {height}");
    }

    #[test]
    fn unstable_attitude_loop_is_refused() {
        // By Routh, kd < lag kp.
        let attitude_loop = AttitudeLoop::Pd { kp: NANO_KP, kd: NANO_KD };
        let refused =
            Lqr::design_for(&slow(0.05, 0.12), &NANO, &attitude_loop, &ControlSettings::default());
        let error = refused.expect_err("refused").to_string();
        assert!(error.contains("motor lag of 0.12 s"), "{error}");
    }

    #[test]
    fn gain_for_a_lagging_vehicle_keeps_signs_and_decoupled_axes() {
        let attitude_loop = AttitudeLoop::AttitudePd { kp: NANO_KP, kd: NANO_KD };
        let settings = ControlSettings::default();
        let lqr = Lqr::design_for(&slow(0.005, 0.04), &NANO, &attitude_loop, &settings);
        let gain = *lqr.expect("a gain").gain();
        // Found with SciPy on one axis alone, with a pure delay.
        for (column, expected) in [(0, 0.735), (3, 0.457)] {
            assert!((gain[(2, column)] / expected - 1.0).abs() < 0.1, "{}", gain[(2, column)]);
        }
        assert!(gain[(1, 0)].abs() < 1e-6 && gain[(2, 1)].abs() < 1e-6);
        assert!(gain[(0, 2)] > 0.0 && gain[(3, 0)].abs() < 1e-6);
        assert_eq!(gain.fixed_rows::<3>(4).norm(), 0.0, "rates are ignored");
    }

    #[test]
    fn impossible_vehicle_numbers_are_named() {
        let vehicle = HoverVehicle { mass_kg: -1.0, ..QUAD };
        let refused = Lqr::design(&vehicle, &PD, &ControlSettings::default());
        assert!(refused.expect_err("refused").to_string().contains("mass is -1"));
        let settings = ControlSettings { rate_hz: f64::NAN, ..ControlSettings::default() };
        assert!(Lqr::design(&QUAD, &PD, &settings).is_err());
    }
}
