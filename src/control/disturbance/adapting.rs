//! The observer with the physics' parameters in place of constant disturbances.

use vehicle::frame::{Frd, Ned};

use super::DisturbanceObserver;
use super::equilibrium::Disturbance;
use super::motion::Motion;
use crate::clock::VehicleTime;
use crate::control::adaptation::{Adaptation, AdaptationEvent, Moved, Parameters};
use crate::control::attitude_loop::angle_error;
use crate::control::hover_model::HoverVehicle;
use crate::setpoint::{Expected, State};

/// Lower bound on the effectiveness of sent thrust.
const THRUST_SLOPE_MIN: f64 = 0.3;

/// Learning of the physics' parameters, in place of constant disturbances.
#[derive(Clone, Debug)]
pub(super) struct Adapting {
    pub adaptation: Adaptation,
    /// Whether the observer learns constant disturbances once adaptation is distrusted; otherwise
    /// it learns nothing.
    observes: bool,
    /// Filtered less measured velocity, m/s.
    smoothed: Ned,
    /// Whether the learned values have faded completely.
    is_faded: bool,
    /// Time of the last fading step.
    faded: Option<VehicleTime>,
}

impl Adapting {
    fn new(adaptation: Adaptation, observes: bool) -> Self {
        Self { adaptation, observes, smoothed: Ned::zero(), is_faded: false, faded: None }
    }

    /// Discards everything learned and restores trust.
    pub fn reset(&mut self) {
        self.adaptation.reset();
        (self.is_faded, self.faded) = (false, None);
        self.smoothed = Ned::zero();
    }
}

/// Below this size the learned values count as faded.
const FADED_SHARE: f64 = 1e-3;
/// With adapted parameters, the shortest time constant of the velocity offset, s: the feedback
/// follows quicker changes of the reported velocity.
pub(super) const ADAPTING_VELOCITY_S: f64 = 0.25;

impl DisturbanceObserver {
    /// Learns the parameters of the physics instead. If adaptation loses trust, the observer
    /// continues with constant disturbances if `observes`, and with nothing otherwise.
    pub fn adapting(self, adaptation: Adaptation, observes: bool) -> Self {
        Self { adapting: Some(Adapting::new(adaptation, observes)), ..self }
    }

    /// Whether the observer shifts nothing, and will not until it is reset.
    pub fn is_idle(&self) -> bool {
        self.adapting.as_ref().is_some_and(|it| it.is_faded)
    }

    /// The parameters, while adaptation is on and trusted.
    pub fn parameters(&self) -> Option<Parameters> {
        let adapting = self.adapting.as_ref()?;
        adapting.adaptation.is_on().then(|| adapting.adaptation.parameters())
    }

    /// Measured less filtered velocity, m/s.
    pub(super) fn velocity_noise(&self) -> Ned {
        match &self.adapting {
            Some(adapting) if adapting.adaptation.is_on() && self.motion.is_some() => {
                -adapting.smoothed
            }
            _ => Ned::zero(),
        }
    }

    /// Whether the size of a change has become known; true once for each change.
    pub(in crate::control) fn take_change(&mut self) -> bool {
        self.adapting.as_mut().is_some_and(|it| it.adaptation.take_change())
    }

    /// `state` with the filtered velocity.
    pub(in crate::control) fn filtered(&self, state: &State) -> State {
        let velocity = state.velocity + self.disturbance.velocity - self.velocity_noise();
        State { velocity, ..*state }
    }

    /// Latency of an attitude setpoint, s.
    pub(in crate::control) fn lead_s(&self) -> f64 {
        self.chain.actuation.attitude_delay_s(&self.chain.attitude_loop)
    }

    /// Mass, inertia and gravity.
    pub(in crate::control) fn vehicle(&self) -> &HoverVehicle {
        &self.chain.vehicle
    }

    /// Takes the pending event of adaptation.
    pub fn take_event(&mut self) -> Option<AdaptationEvent> {
        self.adapting.as_mut()?.adaptation.take_event()
    }

    /// Records whether the last setpoint met a limit of thrust or tilt.
    pub fn limited(&mut self, is_limited: bool) {
        if let Some(adapting) = &mut self.adapting {
            adapting.adaptation.limited(is_limited);
        }
    }

    /// Records a jump of the estimate and restarts the comparison.
    pub fn jumped(&mut self) {
        self.pause();
        if let Some(adapting) = &mut self.adapting {
            adapting.adaptation.jumped();
        }
    }

    /// The thrust to send, N, for `requested_n` to act under the adapted thrust map: the positive
    /// root of `T (1 + s + k (T/T_h - 1)) = T_requested`.
    pub fn thrust_n(&self, requested_n: f64) -> f64 {
        let Some(Parameters { thrust_share, thrust_bend, .. }) = self.parameters() else {
            return requested_n;
        };
        let linear = (1.0 + thrust_share - thrust_bend).max(THRUST_SLOPE_MIN);
        let bend = thrust_bend / self.chain.vehicle.hover_thrust_n();
        let root = (linear * linear + 4.0 * bend * requested_n).max(0.0).sqrt();
        2.0 * requested_n / (linear + root).max(THRUST_SLOPE_MIN)
    }

    /// Whether a state may be learned from. After adaptation loses trust, its learned values become
    /// constant disturbances, which the observer keeps learning or lets fade.
    pub(super) fn is_sound(&mut self, at: VehicleTime, state: &State, dt: f64) -> bool {
        let Some(Adapting { adaptation, observes, is_faded, faded, .. }) = &mut self.adapting
        else {
            return true;
        };
        if !adaptation.is_on() {
            if !*observes {
                let since_s = faded.replace(at).map_or(0.0, |before| at.seconds_since(before));
                self.disturbance.fade(Adaptation::fading(since_s.max(0.0)));
                *is_faded |= self.disturbance.is_below(FADED_SHARE);
            }
            return *observes && state.is_finite();
        }
        if adaptation.sees(state, dt) {
            return true;
        }
        self.fall_back();
        false
    }

    /// Switches to constant disturbances: the learned thrust becomes one of them.
    fn fall_back(&mut self) {
        let d = &mut self.disturbance;
        if let Some(adapting) = &self.adapting {
            let share = adapting.adaptation.parameters().thrust_share;
            d.along_thrust = -share * self.chain.vehicle.gravity;
        }
        if !d.is_below(f64::INFINITY) {
            *d = Disturbance::default();
        }
        self.motion = None;
    }

    /// Learns the physics' parameters, and derives the disturbances from them.
    pub(super) fn adapt(
        &mut self,
        motion: &Motion,
        before: &Motion,
        at: VehicleTime,
        state: &State,
        expected: &Expected,
        dt: f64,
    ) {
        let velocity = state.velocity + self.disturbance.velocity;
        let attitude = before.seen.attitude.between(state.attitude, 0.5);
        let thrust_n = 0.5 * (before.thrust_n + motion.thrust_n);
        let thrust_m_s2 = thrust_n / self.chain.vehicle.mass_kg;
        let unexplained = angle_error(state.attitude.euler(), motion.attitude);
        let moved = Moved {
            at,
            dt,
            attitude,
            flow: Ned::new(velocity.north(), velocity.east(), 0.0),
            thrust_m_s2,
            thrust_over_hover: thrust_n / self.chain.vehicle.hover_thrust_n(),
            known: attitude.to_world(Frd::new(0.0, 0.0, -thrust_m_s2))
                + Ned::new(0.0, 0.0, self.chain.vehicle.gravity)
                + expected.acceleration,
            velocity,
            unexplained: std::array::from_fn(|i| unexplained[i] - expected.attitude[i]),
        };
        let Some(adapting) = &mut self.adapting else { return };
        adapting.adaptation.learn(&moved);
        adapting.smoothed = adapting.adaptation.velocity() - velocity;
        if adapting.adaptation.is_on() {
            self.take_parameters();
        } else {
            self.fall_back();
        }
    }

    pub(super) fn take_parameters(&mut self) {
        let Some(Parameters { drag_per_s, world, body, attitude, .. }) = self.parameters() else {
            return;
        };
        let velocity = self.disturbance.velocity;
        self.disturbance =
            Disturbance { velocity, drag_per_s, world, body, along_thrust: 0.0, attitude };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::{
        Actuation, AdaptationSettings, AttitudeError, AttitudeLoop, Distrust, HoverVehicle,
        OffsetFreeSettings,
    };
    use crate::setpoint::{Reference, Setpoint};
    use vehicle::frame::Euler;

    const QUAD: HoverVehicle =
        HoverVehicle { mass_kg: 1.2, inertia: [0.0115, 0.0125, 0.021], gravity: 9.81 };
    const DT: f64 = 0.01;

    fn observer(observes: bool) -> DisturbanceObserver {
        DisturbanceObserver::new(
            OffsetFreeSettings::default(),
            QUAD,
            AttitudeLoop::PX4,
            AttitudeError::Angles,
            Actuation::IMMEDIATE,
        )
        .adapting(Adaptation::new(AdaptationSettings::default()), observes)
    }

    fn at(tick: u32) -> VehicleTime {
        VehicleTime::from_ms(1000 + tick * 10)
    }

    fn hover(thrust_share: f64) -> Setpoint {
        Setpoint { thrust_n: thrust_share * QUAD.hover_thrust_n(), ..Setpoint::default() }
    }

    /// At rest, with a noise that has a period of a prime number of ticks.
    fn resting(tick: u32) -> State {
        let noise = f64::from(tick * 7919 % 101) / 50.0 - 1.0;
        State {
            position: Ned::new(0.001 * noise, 0.0, -1.0),
            velocity: Ned::new(0.01 * noise, -0.01 * noise, 0.01 * noise),
            ..State::default()
        }
    }

    fn watch(
        observer: &mut DisturbanceObserver,
        ticks: std::ops::Range<u32>,
        sent: &Setpoint,
        state: impl Fn(u32) -> State,
    ) -> Vec<AdaptationEvent> {
        let mut events = Vec::new();
        for tick in ticks {
            observer.observe(at(tick), &state(tick), sent, &Expected::default());
            events.extend(observer.take_event());
        }
        events
    }

    /// An observer that has learned that the vehicle is a fifth heavier.
    fn taught(observes: bool) -> DisturbanceObserver {
        let mut observer = observer(observes);
        watch(&mut observer, 0..500, &hover(1.2), resting);
        let requested_n = QUAD.hover_thrust_n();
        assert!((observer.thrust_n(requested_n) / requested_n - 1.2).abs() < 0.02);
        observer
    }

    fn why(events: &[AdaptationEvent]) -> Option<Distrust> {
        events.iter().find_map(|event| match event {
            AdaptationEvent::SwitchedOff(distrust) => Some(*distrust),
            AdaptationEvent::Changed(_) => None,
        })
    }

    #[test]
    fn heavier_vehicle_is_reported_and_compensated() {
        let mut observer = observer(false);
        let events = watch(&mut observer, 0..500, &hover(1.2), resting);
        let [AdaptationEvent::Changed(change)] = events[..] else { panic!("{events:?}") };
        assert!(change.to_string().starts_with("mass +20 % or thrust -17 %"), "{change}");
        let shift = observer.shift(&Reference::default(), 0.0);
        assert!(shift.attitude.roll.abs() < 0.005 && shift.input.thrust_n.abs() < 0.01);
    }

    #[test]
    fn frozen_jumping_or_nan_estimates_switch_adaptation_off_completely() {
        let nan = |tick| State { velocity: Ned::new(f64::NAN, 0.0, 0.0), ..resting(tick) };
        let jumping = |tick: u32| {
            let side = if tick % 4 < 2 { 2.0 } else { -2.0 };
            State { velocity: Ned::new(side, 0.0, 0.0), ..resting(tick) }
        };
        let mut frozen = taught(false);
        let mut spoiled = [taught(false), taught(false)];
        let events = watch(&mut frozen, 500..600, &hover(1.2), |_| resting(7));
        assert_eq!(why(&events), Some(Distrust::Frozen));
        assert_eq!(
            why(&watch(&mut spoiled[0], 500..600, &hover(1.2), nan)),
            Some(Distrust::NotFinite)
        );
        assert_eq!(
            why(&watch(&mut spoiled[1], 500..600, &hover(1.2), jumping)),
            Some(Distrust::Jumping)
        );
        for observer in spoiled.iter_mut().chain([&mut frozen]) {
            let requested_n = QUAD.hover_thrust_n();
            let shift = observer.shift(&Reference::default(), 0.0);
            assert!(shift.input.is_finite(), "{shift:?}");
            let events = watch(observer, 600..1500, &hover(1.0), resting);
            assert!(observer.is_idle() && events.is_empty());
            assert_eq!(observer.thrust_n(requested_n), requested_n);
            observer.reset();
            assert!(!observer.is_idle() && observer.parameters().is_some());
        }
    }

    #[test]
    fn prolonged_saturation_switches_adaptation_off() {
        let mut observer = taught(false);
        observer.limited(true);
        let events = watch(&mut observer, 500..800, &hover(1.2), resting);
        assert_eq!(why(&events), Some(Distrust::Saturated));
    }

    #[test]
    fn unexplained_motion_switches_adaptation_off() {
        // The vehicle falls as if it had no rotors, whatever is sent.
        let falling = |tick: u32| {
            let t = f64::from(tick) * DT;
            let velocity = Ned::new(0.0, 0.0, 9.0 * t);
            State { position: Ned::new(0.0, 0.0, 4.5 * t * t), velocity, ..State::default() }
        };
        let events = watch(&mut observer(false), 0..600, &hover(1.0), falling);
        let why = why(&events);
        assert!(matches!(why, Some(Distrust::Bound | Distrust::Diverging)), "{why:?}");
    }

    #[test]
    fn disturbance_observer_continues_after_adaptation_switches_off() {
        let mut observer = taught(true);
        watch(&mut observer, 500..600, &hover(1.2), |_| resting(7));
        assert!(observer.parameters().is_none() && !observer.is_idle());
        watch(&mut observer, 600..1200, &hover(1.2), resting);
        let shift = observer.shift(&Reference::default(), 0.0);
        assert!((shift.input.thrust_n / QUAD.hover_thrust_n() - 0.2).abs() < 0.02, "{shift:?}");
    }

    #[test]
    fn weak_rotor_is_named_from_its_moment() {
        let mut observer = observer(false);
        // Held level against: the attitude sent is the negative of what the moment turns by.
        let sent = Setpoint { attitude: Euler::new(-0.1, 0.1, -0.02), ..hover(1.066) };
        let events = watch(&mut observer, 0..500, &sent, resting);
        let text = events.iter().map(|event| format!("{event}\n")).collect::<String>();
        assert!(text.contains("less thrust at the front right rotor"), "{text}");
    }
}
