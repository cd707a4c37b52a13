//! Geometric tracking on SE(3): the wanted force vector determines thrust and attitude.

use vehicle::frame::{Euler, Frd, Ned};
use vehicle::rigid_body::State;

use super::super::tilt::tilt_towards;
use super::{Command, ControlLaw, ControlProblem, DesignError, Gain, LawSpec, Lqr, Reach};
use crate::setpoint::{Reference, Setpoint};

/// The law in the table of laws.
pub(super) static SPEC: LawSpec = LawSpec {
    id: "geometric",
    summary: "Tracking on SE(3) (Lee, Leok, McClamroch 2010): valid at any attitude.",
    gains: &[POSITION, VELOCITY],
    design: |problem| Ok(Box::new(Geometric::design(problem)?)),
};

/// Gains shared by every law built on this one.
pub(super) const POSITION: Gain = Gain {
    key: "gains.position_per_s2",
    unit: "1/s^2",
    values: 2,
    meaning: "acceleration over position error, horizontal and vertical: kx/m",
};
pub(super) const VELOCITY: Gain = Gain {
    key: "gains.velocity_per_s",
    unit: "1/s",
    values: 2,
    meaning: "acceleration over velocity error, horizontal and vertical: kv/m",
};

/// Least upward part of the wanted force, relative to the weight; below it, its direction would
/// define no attitude (the paper's assumption `|A| > 0`).
const LIFT_MIN: f64 = 0.1;

/// The tracking law of Lee, Leok and McClamroch ("Geometric tracking control of a quadrotor UAV on
/// SE(3)", CDC 2010, eq. 12, 15 and 16), over a loop that tracks the attitude in place of the
/// paper's moments:
///
/// ```text
/// f     = f* - kx (p - p*) - kv (v - v*)          wanted force over mass, world axes (m/s^2)
/// u1    = -m f . (R e3)                           thrust (N), along the body's own axis
/// R_d   : R_d e3 = -f / |f|, heading psi*         desired attitude
/// omega = R^T R* omega*                           desired body rate, turned into the body's axes
/// ```
///
/// `f* = -(u1*/m) R* e3` is the force of the reference, so the law also compensates what a plan or
/// a feed-forward compensates (acceleration, drag, wind). The lead of the reference's attitude
/// setpoint over its attitude is added to `R_d`. The law leaves the turn of `R_d` that the errors
/// themselves cause to the attitude loop: computing it takes a derivative of the measured velocity.
///
/// Thrust is the projection of the force on the body's axis: upside down it is zero, where the LQR
/// would keep pushing with hover thrust towards the ground. Where the wanted force exceeds the tilt
/// limit, the law shortens its horizontal part, which keeps the height.
///
/// The gains default to those of the LQR for the same vehicle ([`Lqr::translational`]): the
/// bandwidth near hover is the same, and accounts for the known lag and delay.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Geometric {
    mass_kg: f64,
    gravity: f64,
    tilt_max_rad: f64,
    reach: Reach,
    /// Horizontal and vertical.
    position_per_s2: [f64; 2],
    velocity_per_s: [f64; 2],
}

/// The state less the reference, world axes.
pub(super) struct TrackingError {
    /// Position, bounded, m.
    pub position: Ned,
    /// Velocity, m/s.
    pub velocity: Ned,
    /// Whether the position is at a bound.
    pub is_cut: bool,
}

/// Values for north, east and down from a horizontal and a vertical one.
pub(super) fn per_axis([horizontal, vertical]: [f64; 2]) -> [f64; 3] {
    [horizontal, horizontal, vertical]
}

impl Geometric {
    /// Designs the law for a vehicle.
    ///
    /// # Errors
    /// As [`Lqr::design_for`], whose bandwidth it adopts.
    pub fn design(problem: &ControlProblem) -> Result<Self, DesignError> {
        let ControlProblem { vehicle, limits, settings, .. } = problem;
        let (stiffness, damping) = Lqr::for_problem(problem)?.translational(vehicle);
        let axes = |[north, east, down]: [f64; 3]| [0.5 * (north + east), down];
        let gains = &settings.gains;
        Ok(Self {
            mass_kg: vehicle.mass_kg,
            gravity: vehicle.gravity,
            tilt_max_rad: limits.tilt_max_rad,
            reach: (*settings).into(),
            position_per_s2: gains.get("position_per_s2").unwrap_or(axes(stiffness)),
            velocity_per_s: gains.get("velocity_per_s").unwrap_or(axes(damping)),
        })
    }

    /// Acceleration over position error, horizontal and vertical, 1/s^2.
    pub fn position_per_s2(&self) -> [f64; 2] {
        self.position_per_s2
    }

    /// Acceleration over velocity error, horizontal and vertical, 1/s.
    pub fn velocity_per_s(&self) -> [f64; 2] {
        self.velocity_per_s
    }

    /// `f` in a direction that can be flown: upwards, and within the tilt limit.
    fn flyable(&self, force: Ned) -> Ned {
        let [north, east, down] = force.to_array();
        let down = down.min(-LIFT_MIN * self.gravity);
        let most = -down * self.tilt_max_rad.tan();
        // Beyond a quarter turn, the tangent is no bound.
        let scale = if most > 0.0 { (most / north.hypot(east)).min(1.0) } else { 1.0 };
        Ned::new(north * scale, east * scale, down)
    }

    /// The errors that the law sees.
    pub(super) fn error(&self, state: &State, reference: &Reference) -> TrackingError {
        let (position, is_cut) = self.reach.bounded(state.position - reference.position);
        TrackingError { position, velocity: state.velocity - reference.velocity, is_cut }
    }

    /// The reference's own force over mass, world axes, m/s^2.
    pub(super) fn reference_force(&self, reference: &Reference) -> Ned {
        let specific = reference.feedforward.thrust_n / self.mass_kg;
        reference.attitude.attitude().to_world(Frd::new(0.0, 0.0, -specific))
    }

    /// The law's command with `more` force over mass (world axes, m/s^2) added to its own.
    pub(super) fn command_with_force(
        &self,
        state: &State,
        reference: &Reference,
        more: Ned,
    ) -> Command {
        let Reference { attitude: desired, feedforward, .. } = *reference;
        let TrackingError { position, velocity, is_cut } = self.error(state, reference);
        let feedback = position.scale_by(per_axis(self.position_per_s2))
            + velocity.scale_by(per_axis(self.velocity_per_s));
        let desired_attitude = desired.attitude();
        let force = self.flyable(self.reference_force(reference) - feedback + more);
        let axis = state.attitude.to_world(Frd::new(0.0, 0.0, 1.0));
        let thrust_n = -self.mass_kg * force.dot(axis);
        let [roll, pitch] = tilt_towards(-force, state.attitude.yaw());
        let ahead = feedforward.attitude;
        let attitude = Euler::new(
            roll + ahead.roll - desired.roll,
            pitch + ahead.pitch - desired.pitch,
            ahead.yaw,
        );
        let body_rate = state.attitude.to_body(desired_attitude.to_world(feedforward.body_rate));
        Command::absolute(
            reference,
            Setpoint { thrust_n: thrust_n.max(0.0), attitude, body_rate },
            is_cut,
        )
    }
}

impl ControlLaw for Geometric {
    fn command(&mut self, state: &State, reference: &Reference, _dt_s: f64) -> Command {
        self.command_with_force(state, reference, Ned::zero())
    }
}

#[cfg(test)]
mod tests {
    use super::super::quad::{PD, QUAD};
    use super::super::{ControlSettings, Law};
    use super::*;
    use crate::control::{Actuation, AttitudeLoop, Limits};
    use proptest::prelude::*;
    use vehicle::frame::{Attitude, wrap_angle};

    const LATE: Actuation = Actuation { command_delay_s: 0.02, motor_time_constant_s: 0.04 };

    fn designed(actuation: &Actuation, settings: &ControlSettings) -> Geometric {
        let limits = Limits::default();
        let problem = ControlProblem {
            vehicle: &QUAD,
            actuation,
            attitude_loop: &PD,
            limits: &limits,
            settings,
        };
        Geometric::design(&problem).expect("a law")
    }

    fn law() -> Geometric {
        designed(&Actuation::IMMEDIATE, &ControlSettings::default())
    }

    /// The reference that gives the vehicle this acceleration and heading.
    fn carrying(acceleration: Ned, yaw: f64) -> Reference {
        let force = acceleration - Ned::new(0.0, 0.0, QUAD.gravity);
        let [roll, pitch] = tilt_towards(-force, yaw);
        let attitude = Euler::new(roll, pitch, yaw);
        let thrust_n = QUAD.mass_kg * force.norm();
        let feedforward = Setpoint { thrust_n, attitude, ..Setpoint::default() };
        Reference { attitude, feedforward, ..Reference::default() }
    }

    /// The vehicle at the reference.
    fn on(reference: &Reference) -> State {
        State {
            position: reference.position,
            velocity: reference.velocity,
            attitude: reference.attitude.attitude(),
            body_rate: reference.body_rate,
        }
    }

    fn setpoint(state: &State, reference: &Reference) -> Setpoint {
        law().command(state, reference, 0.01).setpoint
    }

    fn is_near(a: Euler, b: Euler, within: f64) -> bool {
        [a.roll - b.roll, a.pitch - b.pitch, a.yaw - b.yaw]
            .into_iter()
            .all(|off| wrap_angle(off).abs() < within)
    }

    #[test]
    fn hover_commands_weight_and_level_attitude_at_any_heading() {
        for yaw in [0.0, 1.0, -3.0] {
            let reference = carrying(Ned::zero(), yaw);
            let sent = setpoint(&on(&reference), &reference);
            assert!((sent.thrust_n - QUAD.hover_thrust_n()).abs() < 1e-9);
            assert!(is_near(sent.attitude, Euler::new(0.0, 0.0, yaw), 1e-12));
            assert_eq!(sent.body_rate, Frd::zero());
        }
    }

    #[test]
    fn pure_yaw_commands_heading_and_rate_without_tilt() {
        let mut reference = carrying(Ned::zero(), 0.5);
        reference.feedforward.body_rate = Frd::new(0.0, 0.0, 1.5);
        reference.body_rate = reference.feedforward.body_rate;
        // A heading error of 0.25 rad: the heading setpoint steps at once, and the thrust stays
        // upright.
        let state = State { attitude: Euler::new(0.0, 0.0, 0.25).attitude(), ..on(&reference) };
        let sent = setpoint(&state, &reference);
        assert!(is_near(sent.attitude, Euler::new(0.0, 0.0, 0.5), 1e-12));
        assert!((sent.body_rate - Frd::new(0.0, 0.0, 1.5)).norm() < 1e-12);
        assert!((sent.thrust_n - QUAD.hover_thrust_n()).abs() < 1e-9);
    }

    #[test]
    fn steady_acceleration_adds_vectorially_to_the_weight() {
        // 3 m/s^2 to the north, heading east: the left side goes down.
        let reference = carrying(Ned::new(3.0, 0.0, 0.0), std::f64::consts::FRAC_PI_2);
        let sent = setpoint(&on(&reference), &reference);
        let (length, tilt) = (3.0_f64.hypot(9.81), (3.0_f64 / 9.81).atan());
        assert!((sent.thrust_n - 1.2 * length).abs() < 1e-9);
        let expected = Euler::new(-tilt, 0.0, std::f64::consts::FRAC_PI_2);
        assert!(is_near(sent.attitude, expected, 1e-9), "{:?}", sent.attitude);
        let command = law().command(&on(&reference), &reference, 0.01);
        assert!(command.feedback.thrust_n.abs() < 1e-9 && !command.is_cut);
    }

    #[test]
    fn errors_command_the_acceleration_given_by_the_gains() {
        let reference = carrying(Ned::zero(), 0.0);
        let state = State {
            position: Ned::new(-0.4, 0.2, 0.1),
            velocity: Ned::new(0.1, -0.2, 0.3),
            ..on(&reference)
        };
        let sent = setpoint(&state, &reference);
        let ([kx, kz], [dx, dz]) = (law().position_per_s2(), law().velocity_per_s());
        let force =
            Ned::new(0.4 * kx - 0.1 * dx, -0.2 * kx + 0.2 * dx, -9.81 - 0.1 * kz - 0.3 * dz);
        assert!((sent.thrust_n + 1.2 * force.down()).abs() < 1e-9);
        let down = sent.attitude.attitude().to_world(Frd::new(0.0, 0.0, 1.0));
        assert!((down + force * (1.0 / force.norm())).norm() < 1e-9);
    }

    #[test]
    fn inverted_vehicle_gets_no_thrust() {
        let reference = carrying(Ned::zero(), 0.0);
        let over = State { attitude: Euler::new(2.97, 0.0, 0.0).attitude(), ..on(&reference) };
        let sent = setpoint(&over, &reference);
        assert_eq!(sent.thrust_n, 0.0);
        assert!(is_near(sent.attitude, Euler::default(), 1e-9));
    }

    #[test]
    fn tilt_limit_cuts_horizontal_force_and_keeps_vertical_thrust() {
        let reference = carrying(Ned::zero(), 0.0);
        let state = State { velocity: Ned::new(-30.0, 0.0, 0.0), ..on(&reference) };
        let sent = setpoint(&state, &reference);
        let tilt = sent.attitude.attitude().tilt();
        assert!((tilt - Limits::default().tilt_max_rad).abs() < 1e-9);
        assert!((sent.thrust_n - QUAD.hover_thrust_n()).abs() < 1e-9);
    }

    #[test]
    fn default_gains_match_the_lqr_near_hover() {
        for actuation in [Actuation::IMMEDIATE, LATE] {
            let settings = ControlSettings::default();
            let geometric = designed(&actuation, &settings);
            let lqr = Lqr::design_for(&actuation, &QUAD, &PD, &settings).expect("a gain");
            let hover = Reference {
                feedforward: Setpoint { thrust_n: QUAD.hover_thrust_n(), ..Setpoint::default() },
                ..Reference::default()
            };
            // Both command the same thrust for height, and settle at the same tilt for distance.
            let below = State { position: Ned::new(0.0, 0.0, 0.1), ..State::default() };
            let (by_lqr, _) = lqr.feedback(&below, &hover);
            let by_force = geometric.clone().command(&below, &hover, 0.0).feedback;
            assert!((by_lqr.thrust_n - by_force.thrust_n).abs() < 1e-6 * by_lqr.thrust_n);
            let ahead = State { position: Ned::new(0.1, 0.0, 0.0), ..State::default() };
            let AttitudeLoop::Pd { kp, kd } = PD else { unreachable!() };
            // The loop's moment at a pitch, under the LQR, is linear and 0 where the pitch settles.
            let turning = |pitch: f64| {
                let attitude = Euler::new(0.0, pitch, 0.0).attitude();
                let (lqr_setpoint, _) = lqr.feedback(&State { attitude, ..ahead }, &hover);
                let [_, rate, _] = lqr_setpoint.body_rate.to_array();
                kp[1] * (lqr_setpoint.attitude.pitch - pitch) + kd[1] * rate
            };
            let settled = -turning(0.0) * 0.01 / (turning(0.01) - turning(0.0));
            let by_force = geometric.clone().command(&ahead, &hover, 0.0).feedback.attitude.pitch;
            assert!((by_force / settled - 1.0).abs() < 0.03, "{by_force} {settled}");
        }
        let mut settings = ControlSettings { law: Law::GEOMETRIC, ..ControlSettings::default() };
        settings.gains.set("position_per_s2", &[4.0, 9.0]);
        let set = designed(&LATE, &settings);
        assert_eq!(set.position_per_s2(), [4.0, 9.0]);
        assert_eq!(
            set.velocity_per_s(),
            designed(&LATE, &ControlSettings::default()).velocity_per_s()
        );
    }

    fn any_attitude() -> impl Strategy<Value = Attitude> {
        (-3.1..3.1f64, -1.5..1.5f64, -3.1..3.1f64)
            .prop_map(|(roll, pitch, yaw)| Euler::new(roll, pitch, yaw).attitude())
    }

    fn any_state() -> impl Strategy<Value = State> {
        let triple = |most: f64| prop::array::uniform3(-most..most);
        (triple(20.0), triple(10.0), any_attitude(), triple(8.0)).prop_map(|(p, v, attitude, w)| {
            State { position: p.into(), velocity: v.into(), attitude, body_rate: w.into() }
        })
    }

    fn any_reference() -> impl Strategy<Value = Reference> {
        let triple = |most: f64| prop::array::uniform3(-most..most);
        (triple(5.0), triple(3.0), triple(5.0), triple(2.0), -3.1..3.1f64).prop_map(
            |(p, v, a, rate, yaw)| {
                let mut reference = carrying(a.into(), yaw);
                (reference.position, reference.velocity) = (p.into(), v.into());
                reference.feedforward.body_rate = rate.into();
                reference
            },
        )
    }

    proptest! {
        #[test]
        fn command_is_always_finite_and_within_the_tilt_limit(
            state in any_state(), reference in any_reference(),
        ) {
            let sent = setpoint(&state, &reference);
            prop_assert!(sent.is_finite() && sent.thrust_n >= 0.0);
            let tilt = Euler { yaw: 0.0, ..sent.attitude }.attitude().tilt();
            prop_assert!(tilt <= Limits::default().tilt_max_rad + 1e-9);
            // The thrust is at most the wanted force, whose errors are bounded except for speed.
            let speed = (state.velocity - reference.velocity).norm();
            let ([kx, kz], [dx, dz]) = (law().position_per_s2(), law().velocity_per_s());
            let most = reference.feedforward.thrust_n / 1.2 + kx + kz + (dx + dz) * speed + 9.81;
            prop_assert!(sent.thrust_n <= 1.2 * most / Limits::default().tilt_max_rad.cos());
        }

        #[test]
        fn rotating_the_world_changes_only_the_heading(
            state in any_state(), reference in any_reference(), turn in -3.0..3.0f64,
        ) {
            let about = Euler::new(0.0, 0.0, turn).attitude();
            let turned = |v: Ned| about.to_world(Frd::from(v.to_array()));
            let heading = |Euler { roll, pitch, yaw }: Euler| Euler::new(roll, pitch, yaw + turn);
            let moved = State {
                position: turned(state.position),
                velocity: turned(state.velocity),
                attitude: about.compose(state.attitude),
                ..state
            };
            let mut led = reference;
            (led.position, led.velocity) = (turned(led.position), turned(led.velocity));
            led.attitude = heading(led.attitude);
            led.feedforward.attitude = heading(led.feedforward.attitude);
            let (here, there) = (setpoint(&state, &reference), setpoint(&moved, &led));
            prop_assert!((here.thrust_n - there.thrust_n).abs() < 1e-6);
            prop_assert!(is_near(heading(here.attitude), there.attitude, 1e-6));
            prop_assert!((here.body_rate - there.body_rate).norm() < 1e-6);
        }
    }
}
