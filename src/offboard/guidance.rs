//! The reference that the vehicle follows in each state of the flight.

mod guided;
mod segment;
mod settings;
mod stop;

use vehicle::frame::{Euler, Frd, Ned, wrap_angle};
use vehicle::rigid_body::State;

pub(super) use self::guided::Guided;
use self::segment::{Segment, Speeds, Waypoint};
pub use self::settings::GuidanceSettings;
use self::stop::Stop;
use super::goal::GoalOffset;
use crate::clock::VehicleTime;
use crate::control::HoverVehicle;
use crate::plan::desire::{Push, Weight};
use crate::plan::reference::ReferenceSource;
use crate::plan::trajectory::DesiredPoint;
use crate::setpoint::{Expected, Reference, Setpoint};
use crate::supervisor::{FlightState, Trigger};
use crate::telemetry::Sample;

/// How far what is to be flown reaches, from the anchor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Extent {
    /// Horizontally, m.
    pub radius_m: f64,
    /// Greatest height, m.
    pub highest_m: f64,
    /// Least height, m.
    pub lowest_m: f64,
}

/// Text of the event at the end of a trajectory; `tube fit` finds it in logs.
pub const TRAJECTORY_DONE: &str = "the trajectory is done";

/// Depth below the take-off point that counts as estimator noise, m.
const FLOOR_NOISE_M: f64 = 0.05;
/// Largest tilt of a stop or an approach, rad; a stop's deceleration needs less.
const TILT_MAX_RAD: f64 = 0.5;
/// Thrust beyond hover thrust, as a share of it, at which the vehicle counts as off the ground.
const LIFTING_EXCESS: f64 = 0.1;
/// Number of steps at which a trajectory's extent is sampled.
const EXTENT_STEPS: usize = 200;

/// Where the next sample holds the vehicle: where it is, or where it can come to rest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Latch {
    Here,
    Ahead,
}

/// What shows whether the vehicle has left the ground, and may.
#[derive(Clone, Copy, Debug)]
pub(super) struct LiftOff {
    /// Whether it is off the ground, as it reports.
    pub airborne: Option<bool>,
    /// The last thrust, N, which shows lift-off before the height does; `None` if not known.
    pub thrust_n: Option<f64>,
    /// Whether a vehicle that has not risen yet waits, its take-off suspended.
    pub waits: bool,
}

/// Chooses the reference. The trajectory's origin is the anchor: the place where the vehicle took
/// off or last stood, or else the point of the local frame's floor below it. Its axes are those of
/// the world.
pub(super) struct Guidance {
    settings: GuidanceSettings,
    vehicle: HoverVehicle,
    /// From the trajectory's model, within 25 % of the vehicle file's.
    hover_thrust_n: f64,
    trajectory: Box<dyn ReferenceSource + Send>,
    /// The trajectory's start, as it last was a number: a planner may fail before the take-off.
    start: Reference,
    /// What its model expects there.
    expected_at_start: Expected,
    /// The anchor of the present flight.
    anchor: Option<Ned>,
    /// Where the vehicle was last seen on the ground.
    ground: Option<Ned>,
    /// The lowest position since take-off began, m down. It shows where the floor is to an estimate
    /// that wanders.
    lowest_down: f64,
    /// Share of the horizontal feedback that thrust above weight has faded in.
    lifted: f64,
    /// How long the take-off has been suspended, s.
    waited_s: f64,
    /// When the last tick was.
    seen: VehicleTime,
    state: FlightState,
    entered: VehicleTime,
    segment: Segment,
    /// The way to the place that is held.
    held: Option<Stop>,
    /// How far the goal was moved, and had been when that way began.
    goal: GoalOffset,
    held_at: Ned,
    /// How the next sample sets the hold, if it does.
    latch: Option<Latch>,
    last: Option<Reference>,
    settled_since: Option<VehicleTime>,
}

impl Guidance {
    pub fn new(
        settings: GuidanceSettings,
        vehicle: HoverVehicle,
        trajectory: Box<dyn ReferenceSource + Send>,
    ) -> Self {
        let weight_n = vehicle.hover_thrust_n();
        let hover_thrust_n = trajectory.start_thrust_n().clamp(0.75 * weight_n, 1.25 * weight_n);
        let start = trajectory.sample(0.0);
        let expected_at_start = expected_at_start(trajectory.as_ref());
        Self {
            settings,
            vehicle,
            hover_thrust_n,
            trajectory,
            start,
            expected_at_start,
            anchor: None,
            ground: None,
            lowest_down: 0.0,
            lifted: 0.0,
            waited_s: 0.0,
            seen: VehicleTime::default(),
            state: FlightState::Connect,
            entered: VehicleTime::default(),
            segment: Segment::default(),
            held: None,
            goal: GoalOffset::default(),
            held_at: Ned::zero(),
            latch: None,
            last: None,
            settled_since: None,
        }
    }

    /// The trajectory's origin, once the flight has begun.
    pub fn anchor(&self) -> Option<Ned> {
        self.anchor
    }

    /// How far the goal was moved from where the flight has it, or is being moved, m.
    pub fn goal(&self) -> Ned {
        self.goal.requested()
    }

    /// Leads what is flown to lie this far from where the flight has it, m.
    pub fn move_goal(&mut self, offset: Ned) {
        self.goal.lead_to(offset);
    }

    /// What is flown lies where the flight has it.
    pub fn forget_goal(&mut self) {
        self.goal = GoalOffset::default();
    }

    /// How far what is flown reaches with its goal moved by `offset`, for a vehicle at `position`.
    pub fn extent(&self, offset: Ned, position: Ned) -> Extent {
        let anchor = self.anchor.unwrap_or_else(|| self.anchor_below(position));
        let (mut radius_m, mut highest_m, mut lowest_m) = (0.0_f64, f64::MIN, f64::MAX);
        let mut reach = |point: Ned| {
            radius_m = radius_m.max(point.north().hypot(point.east()));
            (highest_m, lowest_m) = (highest_m.max(-point.down()), lowest_m.min(-point.down()));
        };
        match self.held.filter(|_| self.state == FlightState::Hold) {
            Some(held) => reach(held.end() - self.held_at + offset - anchor),
            None => {
                let step_s = self.trajectory.duration() / EXTENT_STEPS as f64;
                (0..=EXTENT_STEPS)
                    .for_each(|step| reach(self.trajectory.desired(step as f64 * step_s) + offset));
            }
        }
        Extent { radius_m, highest_m, lowest_m }
    }

    /// The exponent of thrust over voltage that the reference uses.
    pub fn voltage_exponent(&self) -> f64 {
        self.trajectory.voltage_exponent()
    }

    /// The expectation at rest: hover thrust beyond weight, as an acceleration.
    pub fn expected_at_rest(&self) -> Expected {
        self.expected_in_part(0.0)
    }

    /// The expectation at rest with a share of the wind, the trims and the moments that the
    /// trajectory's model expects at its start.
    fn expected_in_part(&self, share: f64) -> Expected {
        let start = self.expected_at_start;
        let [north, east, _] = start.acceleration.to_array();
        let more = (self.hover_thrust_n - self.vehicle.hover_thrust_n()) / self.vehicle.mass_kg;
        Expected {
            acceleration: Ned::new(share * north, share * east, more),
            attitude: start.attitude.map(|angle| share * angle),
        }
    }

    /// Where the vehicle was last seen on the ground.
    pub fn ground(&self) -> Option<Ned> {
        self.ground
    }

    /// Horizontal distance from `position` to the trajectory's start, if the flight began there, m.
    pub fn start_distance_m(&self, position: Ned) -> f64 {
        let start = self.trajectory.sample(0.0).position + self.anchor_below(position);
        let start = start + self.goal.requested();
        (start.north() - position.north()).hypot(start.east() - position.east())
    }

    /// The reference of this tick.
    pub fn guide(&mut self, state: FlightState, sample: &Sample, lift_off: LiftOff) -> Guided {
        let airborne = lift_off.airborne;
        if airborne == Some(false) {
            self.ground = Some(sample.state.position);
        }
        if state != self.state {
            self.enter(state, sample);
        }
        self.goal.step(sample.vehicle);
        let t = sample.vehicle.seconds_since(self.entered);
        let here = &sample.state;
        let mut guided = match state {
            FlightState::TakeOff => self.take_off(t, sample, lift_off),
            FlightState::Approach => self.approach(t, sample),
            FlightState::Track => self.track(t, here),
            FlightState::Hold | FlightState::Land => Guided::fly(self.hold(sample)),
            _ if airborne != Some(false) => Guided::fly(self.stay(here)),
            _ => self.idle(self.settings.idle_thrust, here),
        };
        guided.reference.attitude.yaw = wrap_angle(guided.reference.attitude.yaw);
        guided.reference.feedforward.attitude.yaw =
            wrap_angle(guided.reference.feedforward.attitude.yaw);
        self.last = Some(guided.reference);
        self.seen = sample.vehicle;
        guided
    }

    /// Holds where the next sample shows the vehicle. The estimate jumped, and its old coordinates
    /// now name another place.
    pub fn hold_here(&mut self) {
        self.latch = Some(Latch::Here);
    }

    /// Brings the vehicle to rest from the next sample on, and holds there.
    pub fn stop_ahead(&mut self) {
        self.latch = Some(Latch::Ahead);
    }

    fn enter(&mut self, state: FlightState, sample: &Sample) {
        let here = &sample.state;
        let position = here.position;
        match state {
            FlightState::TakeOff => {
                self.anchor = Some(position);
                (self.lowest_down, self.lifted) = (position.down(), 0.0);
                (self.waited_s, self.seen) = (0.0, sample.vehicle);
                self.goal.arrive();
                let start = self.find_start().position + self.goal.at() + position;
                let top = Ned::new(position.north(), position.east(), start.down());
                let yaw = here.attitude.yaw();
                self.segment = Segment::between(
                    Waypoint { position, yaw },
                    Waypoint { position: top, yaw },
                    self.speeds(self.settings.climb_speed_m_s),
                );
            }
            FlightState::Approach => {
                let from = match self.last {
                    Some(last) if self.state == FlightState::TakeOff => last,
                    _ => self.stay(here),
                };
                let below = self.anchor_below(position);
                let anchor = *self.anchor.get_or_insert(below);
                let start = self.find_start();
                self.goal.arrive();
                let anchor = anchor + self.goal.at();
                self.segment = Segment::between(
                    Waypoint { position: from.position, yaw: from.attitude.yaw },
                    Waypoint { position: start.position + anchor, yaw: start.attitude.yaw },
                    self.speeds(self.settings.approach_speed_m_s),
                );
            }
            FlightState::Hold if self.latch.is_none() => {
                let end = self.last.unwrap_or_else(|| self.stay(here));
                let place = Waypoint { position: end.position, yaw: end.attitude.yaw };
                self.keep(Stop::standing(place, sample.vehicle));
            }
            FlightState::Land => {
                if self.state != FlightState::Hold {
                    self.latch.get_or_insert(Latch::Ahead);
                }
                self.goal.stay();
            }
            FlightState::Standby => (self.anchor, self.held, self.latch) = (None, None, None),
            _ => {}
        }
        (self.state, self.entered, self.settled_since) = (state, sample.vehicle, None);
    }

    fn find_start(&mut self) -> Reference {
        let start = self.trajectory.sample(0.0);
        if start.position.is_finite() && start.attitude.yaw.is_finite() {
            self.start = start;
            self.expected_at_start = expected_at_start(self.trajectory.as_ref());
        }
        self.start
    }

    /// Along the way to the place that is held, moved with the goal; here where nothing is held yet.
    fn hold(&mut self, sample: &Sample) -> Reference {
        let (here, now) = (&sample.state, sample.vehicle);
        let latch = self.latch.take();
        if latch.is_some() {
            self.goal.stay();
        }
        let held = match (latch, self.held) {
            (Some(Latch::Ahead), _) => self.keep(Stop::from_motion(here, now)),
            (None, Some(held)) => held,
            (Some(Latch::Here), _) | (None, None) => {
                let place = Waypoint { position: here.position, yaw: here.attitude.yaw() };
                self.keep(Stop::standing(place, now))
            }
        };
        let mut point = held.at(now);
        point.position += self.goal.at() - self.held_at;
        point.velocity += self.goal.velocity();
        self.carried(&point, Push::default())
    }

    fn keep(&mut self, stop: Stop) -> Stop {
        self.held_at = self.goal.at();
        *self.held.insert(stop)
    }

    fn anchor_below(&self, position: Ned) -> Ned {
        self.ground.unwrap_or(Ned::new(position.north(), position.east(), 0.0))
    }

    /// Raises thrust on the ground without feedback, then climbs along a minimum-jerk profile.
    /// `t` is the time since the take-off began, s.
    fn take_off(&mut self, t: f64, sample: &Sample, lift_off: LiftOff) -> Guided {
        let (s, here) = (self.settings, &sample.state);
        self.lowest_down = self.lowest_down.max(here.position.down());
        let floor = self.segment.from().down().max(self.lowest_down - FLOOR_NOISE_M);
        let height = floor - here.position.down();
        let risen = (height / s.feedback_height_m).clamp(0.0, 1.0);
        let is_waiting = lift_off.waits && risen == 0.0;
        if is_waiting {
            self.waited_s += sample.vehicle.seconds_since(self.seen).max(0.0);
        }
        let t = t - self.waited_s;
        let spooled = (t / s.spool_s).min(1.0);
        if spooled < 1.0 || is_waiting {
            return self.idle(s.idle_thrust + (s.spool_thrust - s.idle_thrust) * spooled, here);
        }
        let climbing = t - s.spool_s;
        let mut reference = self.along(climbing, &self.expected_at_rest());
        let excess = lift_off.thrust_n.map_or(0.0, |thrust_n| thrust_n / self.hover_thrust_n - 1.0);
        self.lifted = self.lifted.max((excess / LIFTING_EXCESS).clamp(0.0, 1.0));
        let share = risen.max(self.lifted);
        let (p, r, v) = (here.position, reference.position, here.velocity);
        reference.position = Ned::new(
            p.north() + share * (r.north() - p.north()),
            p.east() + share * (r.east() - p.east()),
            r.down(),
        );
        reference.velocity = Ned::new(
            (1.0 - share) * v.north(),
            (1.0 - share) * v.east(),
            reference.velocity.down(),
        );
        let thrust = s.spool_thrust + (1.0 - s.spool_thrust) * (climbing / s.spool_s).min(1.0);
        reference.feedforward.thrust_n = thrust * self.hover_thrust_n;
        let off = self.segment.to().down() - here.position.down();
        let there = climbing >= self.segment.duration_s()
            && off.abs() < s.settle_radius_m.max(0.25 * self.segment.step().norm())
            && here.velocity.norm() < 2.0 * s.settle_speed_m_s;
        let reached = there.then_some((Trigger::TakenOff, "at the start height"));
        Guided { reached, aloft: risen >= 1.0, ..Guided::fly(reference) }
    }

    fn approach(&mut self, t: f64, sample: &Sample) -> Guided {
        let s = self.settings;
        let expected = self.expected_in_part(self.segment.share(t));
        let reference = self.along(t, &expected);
        let over = t - self.segment.duration_s();
        let still = over >= 0.0 && sample.state.velocity.norm() < s.settle_speed_m_s;
        let near = (sample.state.position - reference.position).norm() < s.settle_radius_m;
        if still && (near || over > s.settle_timeout_s) {
            self.settled_since.get_or_insert(sample.vehicle);
        } else {
            self.settled_since = None;
        }
        let settled = self
            .settled_since
            .is_some_and(|since| sample.vehicle.seconds_since(since) >= s.settle_s);
        let why = if near { "at the start" } else { "at rest beside the start" };
        Guided {
            expected: Some(expected),
            reached: settled.then_some((Trigger::StartReached, why)),
            ..Guided::fly(reference)
        }
    }

    fn track(&self, t: f64, here: &State) -> Guided {
        let anchor = self.anchor.unwrap_or_default() + self.goal.at();
        self.trajectory.observe(t, &State { position: here.position - anchor, ..*here });
        let mut reference = self.trajectory.sample(t);
        reference.position += anchor;
        reference.velocity += self.goal.velocity();
        let over = t >= self.trajectory.duration();
        let expected = self.trajectory.expected(t);
        Guided {
            desired: self.trajectory.desired(t) + anchor,
            tube_radius_m: self.trajectory.tube_radius_m(t),
            expected,
            is_led: expected.is_some(),
            trajectory_time: Some(t),
            reached: over.then_some((Trigger::TrajectoryDone, TRAJECTORY_DONE)),
            ..Guided::fly(reference)
        }
    }

    fn speeds(&self, speed_m_s: f64) -> Speeds {
        Speeds { speed_m_s, yaw_rate_rad_s: self.settings.approach_yaw_rate_rad_s }
    }

    /// The reference along the segment, with the tilt and the attitude setpoint that hold against
    /// what is expected.
    fn along(&self, t: f64, expected: &Expected) -> Reference {
        let [north, east, _] = expected.acceleration.to_array();
        let setpoint = expected.attitude.map(|angle| -angle);
        self.carried(
            &self.segment.at(t),
            Push { world: [north, east], heading: [0.0; 2], setpoint },
        )
    }

    fn stay(&self, here: &State) -> Reference {
        self.level(here.position, here.attitude.yaw())
    }

    fn level(&self, position: Ned, yaw: f64) -> Reference {
        let attitude = Euler::new(0.0, 0.0, yaw);
        let input = Setpoint { thrust_n: self.hover_thrust_n, attitude, body_rate: Frd::zero() };
        Reference::led_by(input, position, Ned::zero())
    }

    /// The reference at a point, with the tilt and the thrust that produce its acceleration against
    /// a push.
    fn carried(&self, point: &DesiredPoint, push: Push) -> Reference {
        let HoverVehicle { mass_kg, gravity, .. } = self.vehicle;
        let weight = Weight { mass_kg, gravity, push, tilt_max_rad: TILT_MAX_RAD };
        let (thrust_n, attitude) = weight.carry(point);
        let thrust_n = thrust_n / self.vehicle.hover_thrust_n() * self.hover_thrust_n;
        let body_rate = Frd::new(0.0, 0.0, point.yaw_rate);
        let input = Setpoint { thrust_n, attitude, body_rate };
        let mut reference = Reference::led_by(input, point.position, point.velocity);
        let [roll, pitch, yaw] = push.setpoint;
        let Euler { roll: r, pitch: p, yaw: y } = attitude;
        reference.feedforward.attitude = Euler::new(r + roll, p + pitch, y + yaw);
        reference
    }

    fn idle(&self, thrust: f64, here: &State) -> Guided {
        let mut reference = self.stay(here);
        reference.feedforward.thrust_n = thrust * self.hover_thrust_n;
        Guided { feedback: false, aloft: false, ..Guided::fly(reference) }
    }
}

/// What a trajectory's model expects at its start; nothing where none leads.
fn expected_at_start(trajectory: &dyn ReferenceSource) -> Expected {
    trajectory.expected(0.0).filter(Expected::is_finite).unwrap_or_default()
}
