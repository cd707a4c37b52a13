//! Estimation of the forces and moments on the vehicle beyond thrust, weight and the attitude loop,
//! and the equilibrium under them.

mod adapting;
mod equilibrium;
mod motion;
mod settings;

use vehicle::frame::{Frd, Heading, Ned};

use self::adapting::{ADAPTING_VELOCITY_S, Adapting};
use self::equilibrium::Disturbance;
pub use self::equilibrium::Shift;
use self::motion::{Chain, Motion};
pub use self::settings::{OffsetFreeSettings, Use};
use super::actuation::Actuation;
use super::attitude_loop::{AttitudeError, AttitudeLoop, angle_error};
use super::hover_model::HoverVehicle;
use crate::clock::VehicleTime;
use crate::setpoint::{Expected, Reference, Setpoint, State};

/// Largest drag over mass, 1/s.
const DRAG_MAX_PER_S: f64 = 2.0;
/// Speed from which drag takes most of an unexplained acceleration along it, m/s.
const DRAG_SPEED_M_S: f64 = 1.0;
/// Share of an unexplained horizontal acceleration that is first attributed to body axes.
const BODY_SHARE: f64 = 0.5;
/// Samples farther apart than this are not compared, s.
const GAP_MAX_S: f64 = 0.2;

/// Estimates the disturbances that explain the vehicle's motion: a Luenberger observer of the
/// near-hover model with disturbances as additional states.
///
/// ```text
/// dp/dt = v + d_v
/// dv/dt = g e3 + R(zeta) (0, 0, d_t - T/m) + d_w + R(psi) d_b - c v + expected
/// zeta  = loop(sent) + d_a + expected
/// ```
///
/// Position, velocity and attitude are measured. The setpoint is the one that was sent, limits
/// included, so nothing winds up. What the reference's model expects is not estimated again. The
/// attitude in the second line is the measured one: the estimate does not depend on how well the
/// attitude loop is known, and its feedback closes no loop through it.
#[derive(Clone, Debug)]
pub struct DisturbanceObserver {
    settings: OffsetFreeSettings,
    chain: Chain,
    motion: Option<Motion>,
    disturbance: Disturbance,
    adapting: Option<Adapting>,
}

impl DisturbanceObserver {
    /// An observer with zero disturbances.
    pub fn new(
        settings: OffsetFreeSettings,
        vehicle: HoverVehicle,
        attitude_loop: AttitudeLoop,
        error: AttitudeError,
        actuation: Actuation,
    ) -> Self {
        let (motion, disturbance, adapting) = (None, Disturbance::default(), None);
        let chain = Chain { vehicle, attitude_loop, error, actuation };
        Self { settings, chain, motion, disturbance, adapting }
    }

    /// Discards everything: nothing is known on the ground, or after something else flew the
    /// vehicle.
    pub fn reset(&mut self) {
        (self.motion, self.disturbance) = (None, Disturbance::default());
        if let Some(adapting) = &mut self.adapting {
            adapting.reset();
        }
    }

    /// Keeps the disturbances and restarts the comparison: the estimate jumped, or no setpoint was
    /// sent.
    pub fn pause(&mut self) {
        self.motion = None;
        if let Some(adapting) = &mut self.adapting {
            adapting.adaptation.pause();
        }
    }

    /// Corrects the estimates for a new leading model, which expects `change` more than the last:
    /// the disturbances shrink by as much.
    pub fn expect_anew(&mut self, change: &Expected) {
        if let Some(adapting) = &mut self.adapting
            && adapting.adaptation.is_on()
        {
            let gravity = self.chain.vehicle.gravity;
            adapting.adaptation.expect_anew(change.acceleration, change.attitude, gravity);
            return self.take_parameters();
        }
        let [north, east, down] = change.acceleration.to_array();
        let d = &mut self.disturbance;
        d.world = [d.world[0] - north, d.world[1] - east];
        d.along_thrust -= down;
        for (d, change) in d.attitude.iter_mut().zip(change.attitude) {
            *d -= change;
        }
    }

    /// Updates the estimates with the state at `at` and the setpoint sent since the last one, its
    /// thrust as it is estimated to act.
    pub fn observe(
        &mut self,
        at: VehicleTime,
        state: &State,
        sent: &Setpoint,
        expected: &Expected,
    ) {
        let last = self.motion.map(|motion| (motion, at.seconds_since(motion.at)));
        let last = last.filter(|(_, dt)| *dt > 0.0 && *dt < GAP_MAX_S);
        if !self.is_sound(at, state, last.map_or(0.0, |(_, dt)| dt)) {
            return;
        }
        let Some((before, dt)) = last else {
            self.motion =
                Some(Motion::starting(at, state, sent, state.velocity + self.disturbance.velocity));
            return;
        };
        let mut motion = self.chain.moved(before, sent, dt);
        self.learn_velocity(&mut motion, &before, state, dt);
        if self.parameters().is_some() {
            self.adapt(&motion, &before, at, state, expected, dt);
        } else {
            self.learn_constants(&mut motion, &before, state, expected, dt);
        }
        (motion.at, motion.seen) = (at, *state);
        self.motion = Some(motion).filter(Motion::is_finite);
    }

    /// Learns constant disturbances.
    fn learn_constants(
        &mut self,
        motion: &mut Motion,
        before: &Motion,
        state: &State,
        expected: &Expected,
        dt: f64,
    ) {
        let decay = (-dt / self.settings.time_constant_s).exp();
        self.learn_acceleration(motion, before, state, expected, dt, decay);
        let unexplained = angle_error(state.attitude.euler(), motion.attitude);
        let bound = self.settings.attitude_max_rad;
        for (i, unexplained) in unexplained.into_iter().enumerate() {
            let d = &mut self.disturbance.attitude[i];
            *d += (1.0 - decay) * (unexplained - expected.attitude[i] - *d);
            *d = d.clamp(-bound, bound);
        }
    }

    /// Learns the velocity offset from the position's step and the mean of the velocities at both
    /// ends: both poles of position and velocity error at the same decay per step.
    fn learn_velocity(&mut self, motion: &mut Motion, before: &Motion, state: &State, dt: f64) {
        let time_constant_s = match self.parameters() {
            Some(_) => self.settings.velocity_time_constant_s.max(ADAPTING_VELOCITY_S),
            None => self.settings.velocity_time_constant_s,
        };
        let decay = (-dt / time_constant_s).exp();
        let d = &mut self.disturbance.velocity;
        let mean = (before.seen.velocity + state.velocity) * 0.5;
        let foreseen = before.position + (mean + *d) * dt;
        let error = state.position - foreseen;
        motion.position = foreseen + error * (1.0 - decay * decay);
        *d += error * ((1.0 - decay).powi(2) / dt);
        let largest = self.settings.velocity_max_m_s;
        *d = *d * (largest / d.norm()).min(1.0);
    }

    /// Learns the accelerations: both poles of velocity and acceleration error at `decay` per step.
    fn learn_acceleration(
        &mut self,
        motion: &mut Motion,
        before: &Motion,
        state: &State,
        expected: &Expected,
        dt: f64,
        decay: f64,
    ) {
        let mean = before.seen.attitude.between(state.attitude, 0.5);
        let thrust_n = 0.5 * (before.thrust_n + motion.thrust_n);
        let along = self.disturbance.along_thrust - thrust_n / self.chain.vehicle.mass_kg;
        let heading = Heading::new(mean.yaw());
        let Disturbance { world: [north, east], body: [front, right], drag_per_s, .. } =
            self.disturbance;
        let velocity = state.velocity + self.disturbance.velocity;
        let flow = Ned::new(velocity.north(), velocity.east(), 0.0);
        let acceleration = mean.to_world(Frd::new(0.0, 0.0, along))
            + Ned::new(north, east, self.chain.vehicle.gravity)
            + heading.to_world([front, right, 0.0])
            - flow * drag_per_s
            + expected.acceleration;
        let foreseen = before.velocity + acceleration * dt;
        let error = velocity - foreseen;
        motion.velocity = foreseen + error * (1.0 - decay * decay);
        let step = error * ((1.0 - decay).powi(2) / dt);
        let [ahead, aside, _] = heading.to_level(step);
        let down = mean.to_body(step).down();
        let largest = self.settings.acceleration_max_m_s2;
        let trim = self.chain.vehicle.gravity * self.settings.attitude_max_rad;
        let d = &mut self.disturbance;
        let share = 1.0 - BODY_SHARE;
        d.world = bounded([north + share * step.north(), east + share * step.east()], largest);
        d.body =
            bounded([front + BODY_SHARE * ahead, right + BODY_SHARE * aside], trim.min(largest));
        let slowed = -flow.dot(step) / (DRAG_SPEED_M_S.powi(2) + flow.dot(flow));
        d.drag_per_s = (d.drag_per_s + slowed).clamp(0.0, DRAG_MAX_PER_S);
        d.along_thrust = (d.along_thrust + down).clamp(-largest, largest);
    }

    /// `state` with the velocity at which its position moves, which the reported one may differ
    /// from.
    pub fn moving(&self, state: &State) -> State {
        State { velocity: state.velocity + self.disturbance.velocity, ..*state }
    }

    /// How the disturbances shift the reference and input for a vehicle at the heading `yaw` along
    /// `reference`.
    pub fn shift(&self, reference: &Reference, yaw: f64) -> Shift {
        let shift = self.disturbance.shift(&self.chain.vehicle, reference, yaw);
        if self.adapting.is_none() {
            return shift;
        }
        Shift { velocity: shift.velocity + self.velocity_noise(), ..shift }
    }
}

fn bounded([x, y]: [f64; 2], largest: f64) -> [f64; 2] {
    let scale = (largest / x.hypot(y)).min(1.0);
    [x * scale, y * scale]
}

#[cfg(test)]
mod tests {
    use super::*;
    use vehicle::frame::Euler;
    use vehicle::rigid_body::RigidBody;

    const QUAD: HoverVehicle =
        HoverVehicle { mass_kg: 1.2, inertia: [0.0115, 0.0125, 0.021], gravity: 9.81 };
    const PERIOD_S: f64 = 0.01;

    fn observer() -> DisturbanceObserver {
        DisturbanceObserver::new(
            OffsetFreeSettings::default(),
            QUAD,
            AttitudeLoop::PX4,
            AttitudeError::Rotation,
            Actuation::IMMEDIATE,
        )
    }

    fn at(tick: u32) -> VehicleTime {
        VehicleTime::from_ms(1000 + tick * 10)
    }

    /// An observer of a vehicle that stays at `state`, moving and turning as that states, under the
    /// setpoint `sent`.
    fn watched(
        state: State,
        sent: &Setpoint,
        expected: &Expected,
        ticks: u32,
    ) -> DisturbanceObserver {
        let mut observer = observer();
        for tick in 0..ticks {
            let t = f64::from(tick) * PERIOD_S;
            let position = state.position + state.velocity * t;
            observer.observe(at(tick), &State { position, ..state }, sent, expected);
        }
        observer
    }

    fn hover(thrust_share: f64) -> Setpoint {
        Setpoint { thrust_n: thrust_share * QUAD.hover_thrust_n(), ..Setpoint::default() }
    }

    #[test]
    fn extra_thrust_for_a_heavier_vehicle_is_learned() {
        let observer = watched(State::default(), &hover(1.2), &Expected::default(), 500);
        let shift = observer.shift(&Reference::default(), 0.0);
        assert!((shift.input.thrust_n - 0.2 * QUAD.hover_thrust_n()).abs() < 0.01);
        assert!(shift.attitude.pitch.abs() < 1e-6 && shift.velocity.norm() < 1e-6);
    }

    #[test]
    fn tilt_against_wind_is_learned_for_every_heading() {
        // Nose down into a wind from the north, which pushes south.
        let attitude = Euler::new(0.0, -0.2, 0.0);
        let state = State { attitude: attitude.attitude(), ..State::default() };
        let sent = Setpoint { attitude, ..hover(1.0 / 0.2_f64.cos()) };
        let observer = watched(state, &sent, &Expected::default(), 500);
        let shift = observer.shift(&Reference::default(), 0.0);
        assert!((shift.attitude.pitch + 0.2).abs() < 0.01, "{shift:?}");
        assert!((shift.input.attitude.pitch - shift.attitude.pitch).abs() < 0.005);
    }

    #[test]
    fn expected_disturbance_is_not_estimated_again() {
        let attitude = Euler::new(0.0, -0.2, 0.0);
        let state = State { attitude: attitude.attitude(), ..State::default() };
        let sent = Setpoint { attitude: Euler::new(0.0, -0.15, 0.0), ..hover(1.0) };
        let push = 9.81 * 0.2_f64.sin();
        let sink = 9.81 * (1.0 - 0.2_f64.cos());
        let expected =
            Expected { acceleration: Ned::new(-push, 0.0, -sink), attitude: [0.0, -0.05, 0.0] };
        let observer = watched(state, &sent, &expected, 500);
        let shift = observer.shift(&Reference::default(), 0.0);
        assert!(shift.attitude.pitch.abs() < 1e-3, "{shift:?}");
        assert!(shift.input.attitude.pitch.abs() < 1e-3 && shift.input.thrust_n.abs() < 0.02);
    }

    #[test]
    fn new_model_expectation_is_not_counted_twice() {
        let heavier = Ned::new(0.0, 0.0, 0.2 * QUAD.gravity);
        let mut observer = watched(State::default(), &hover(1.2), &Expected::default(), 500);
        observer.expect_anew(&Expected { acceleration: heavier, ..Expected::default() });
        let shift = observer.shift(&Reference::default(), 0.0);
        assert!(shift.input.thrust_n.abs() < 0.01, "{shift:?}");
    }

    #[test]
    fn steady_attitude_offset_is_compensated() {
        let state = State { attitude: Euler::new(0.05, 0.0, 0.1).attitude(), ..State::default() };
        let observer = watched(state, &hover(1.0), &Expected::default(), 500);
        let shift = observer.shift(&Reference::default(), 0.1);
        let beside = shift.input.attitude.roll - shift.attitude.roll;
        assert!((beside + 0.05).abs() < 1e-3, "{shift:?}");
        assert!((shift.input.attitude.yaw + 0.1).abs() < 1e-3, "{shift:?}");
    }

    #[test]
    fn velocity_bias_is_separated_from_motion() {
        let mut observer = observer();
        let state = State { velocity: Ned::new(0.0, -0.13, 0.0), ..State::default() };
        for tick in 0..300 {
            observer.observe(at(tick), &state, &hover(1.0), &Expected::default());
        }
        let shift = observer.shift(&Reference::default(), 0.0);
        assert!((shift.velocity - state.velocity).norm() < 1e-3, "{shift:?}");
        assert!(shift.attitude.roll.abs() < 0.01, "{shift:?}");
    }

    #[test]
    fn estimates_stay_in_bounds_and_reset_clears_them() {
        let settings = OffsetFreeSettings::default();
        let state = State { velocity: Ned::new(30.0, 0.0, 0.0), ..State::default() };
        let mut observer = observer();
        for tick in 0..200 {
            let down = -0.5 * 40.0 * (f64::from(tick) * PERIOD_S).powi(2);
            let state = State { position: Ned::new(0.0, 0.0, down), ..state };
            let sent = Setpoint { attitude: Euler::new(0.5, 0.5, 2.0), ..hover(1.5) };
            observer.observe(at(tick), &state, &sent, &Expected::default());
            let Disturbance { velocity, drag_per_s, world, body, along_thrust, attitude } =
                observer.disturbance;
            assert!(velocity.norm() <= settings.velocity_max_m_s * (1.0 + 1e-9));
            assert!((0.0..=DRAG_MAX_PER_S).contains(&drag_per_s));
            let largest = settings.acceleration_max_m_s2 * (1.0 + 1e-9);
            assert!(world[0].hypot(world[1]) <= largest && body[0].hypot(body[1]) <= largest);
            assert!(along_thrust.abs() <= largest);
            assert!(attitude.iter().all(|angle| angle.abs() <= settings.attitude_max_rad));
        }
        observer.reset();
        let shift = observer.shift(&Reference::default(), 0.0);
        assert_eq!(shift.input.thrust_n, 0.0);
        assert_eq!(shift.velocity, Ned::zero());
    }

    #[test]
    fn drag_on_a_circle_is_distinguished_from_wind() {
        const DRAG_PER_S: f64 = 0.6;
        let wind = Ned::new(2.0, -1.0, 0.0);
        let body = RigidBody::new(QUAD.mass_kg, QUAD.inertia, QUAD.gravity);
        let mut observer = observer();
        let turn = 1.3_f64;
        for tick in 0..2000 {
            let (sin, cos) = (turn * f64::from(tick) * PERIOD_S).sin_cos();
            let position = Ned::new(sin, -cos, 0.0);
            let velocity = Ned::new(cos, sin, 0.0) * turn;
            let centripetal = Ned::new(-sin, cos, 0.0) * turn.powi(2);
            let carried = centripetal + (velocity - wind) * DRAG_PER_S - Ned::new(0.0, 0.0, 9.81);
            let [north, east, down] = carried.to_array();
            let attitude = Euler::new((east / carried.norm()).asin(), (-north).atan2(-down), 0.0);
            let thrust_n = QUAD.mass_kg * carried.norm();
            let state =
                State { position, velocity, attitude: attitude.attitude(), ..State::default() };
            let (push, _) = body.accelerations(&state, Frd::new(0.0, 0.0, -thrust_n), Frd::zero());
            assert!((push - centripetal - (velocity - wind) * DRAG_PER_S).norm() < 1e-9);
            let sent = Setpoint { thrust_n, attitude, ..Setpoint::default() };
            observer.observe(at(tick), &state, &sent, &Expected::default());
        }
        let Disturbance {
            velocity, drag_per_s, world: [north, east], body: [front, right], ..
        } = observer.disturbance;
        assert!(velocity.norm() < 1e-3, "{velocity:?}");
        assert!((drag_per_s - DRAG_PER_S).abs() < 0.05, "{drag_per_s}");
        assert!((north + front - DRAG_PER_S * 2.0).abs() < 0.15, "{north} {front}");
        assert!((east + right + DRAG_PER_S).abs() < 0.15, "{east} {right}");
    }
}
