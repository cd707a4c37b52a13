//! Replanning in flight: disturbances, moved goals, planners that are late or fail.

use std::collections::VecDeque;
use std::path::Path;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex};

use downwash::control::Limits;
use downwash::model::physics::{PhysicsModel, PhysicsParameters};
use downwash::model::{ACCELERATIONS, Jacobian, Model, Point};
use downwash::offboard::EffectiveVehicle;
use downwash::plan::Trajectory;
use downwash::plan::discretisation::{CommandedDynamics, Dynamics};
use downwash::plan::planned::{Answer, CommandedInput};
use downwash::plan::planner::{PlanSettings, PlannedVehicle, Planner};
use downwash::plan::problem::StateVector;
use downwash::plan::receding::{RecedingReference, RecedingSettings};
use downwash::plan::reference::ReferenceSource;
use downwash::setpoint::State;
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use vehicle::VehicleParams;
use vehicle::frame::{Euler, Frd, Ned};

const PERIOD_S: f64 = 0.01;

fn vehicle() -> VehicleParams {
    VehicleParams::from_toml_str(include_str!("../config/vehicles/crazyflie.toml"))
        .expect("a vehicle")
}

fn physics() -> Arc<dyn Model> {
    Arc::new(PhysicsModel::new(&vehicle(), &PhysicsParameters::default()).expect("physics"))
}

/// Standing still a metre above the floor.
fn hover_at(north_m: f64) -> Trajectory {
    let point =
        format!("{{ north_m = {north_m:?}, east_m = 0.0, altitude_m = 1.0, hold_s = 30.0 }}");
    let text = format!("family = 'waypoints'\npoints = [{point}, {point}]");
    Trajectory::parse(&text, Path::new("hover.toml")).expect("a trajectory")
}

/// A planner for the built-in vehicle through `model`, and a vehicle that responds at once.
fn planner(model: Arc<dyn Model>) -> (Planner, Answer) {
    let params = vehicle();
    let attitude_pd = params.attitude_pd.expect("a loop");
    let planned = PlannedVehicle {
        body: EffectiveVehicle::new(&params).expect("a vehicle").body(),
        attitude_pd,
        limits: Limits::default(),
    };
    let answer = Answer { delay_s: 0.0, lag_s: 0.0, voltage_exponent: 0.0, attitude_pd };
    (Planner::new(model, planned, PlanSettings::default()).expect("a planner"), answer)
}

fn state_of(s: &StateVector) -> State {
    State {
        position: Ned::new(s[0], s[1], s[2]),
        velocity: Ned::new(s[3], s[4], s[5]),
        attitude: Euler::new(s[6], s[7], s[8]).attitude(),
        body_rate: Frd::new(s[9], s[10], s[11]),
    }
}

/// Follows the reference's inputs alone, without feedback, through the physics that it plans with.
struct Follower {
    model: Arc<dyn Model>,
    state: StateVector,
    tick: usize,
    /// Ticks from sending a setpoint to its use, and the setpoints in transit.
    delay: usize,
    sent: VecDeque<CommandedInput>,
}

impl Follower {
    fn hovering() -> Self {
        let mut state = [0.0; 12];
        state[2] = -1.0;
        Self { model: physics(), state, tick: 0, delay: 0, sent: VecDeque::new() }
    }

    fn time(&self) -> f64 {
        self.tick as f64 * PERIOD_S
    }

    fn follow(&mut self, reference: &RecedingReference, seconds: f64) {
        self.follow_seen(reference, seconds, |state| *state);
    }

    /// The same, where `seen` gives the estimator's view of the state.
    fn follow_seen(
        &mut self,
        reference: &RecedingReference,
        seconds: f64,
        mut seen: impl FnMut(&StateVector) -> StateVector,
    ) {
        let (_, answer) = planner(physics());
        let dynamics = CommandedDynamics::new(self.model.as_ref(), answer.attitude_pd, PERIOD_S);
        for _ in 0..(seconds / PERIOD_S).round() as usize {
            let t = self.time();
            reference.observe(t, &state_of(&seen(&self.state)));
            let sent = reference.sample(t).feedforward;
            let Euler { roll, pitch, yaw } = sent.attitude;
            let [p, q, r] = sent.body_rate.to_array();
            self.sent.push_back([sent.thrust_n, roll, pitch, yaw, p, q, r]);
            // Setpoints in transit act later.
            if self.sent.len() > self.delay {
                let acting = self.sent.pop_front().expect("a setpoint");
                self.state = dynamics.step(&self.state, &acting);
            }
            self.tick += 1;
        }
    }
}

fn inline(goal: Trajectory) -> RecedingReference {
    late(goal, 0.0)
}

/// For a vehicle that responds `delay_s` later.
fn late(goal: Trajectory, delay_s: f64) -> RecedingReference {
    let (planner, answer) = planner(physics());
    let answer = Answer { delay_s, ..answer };
    RecedingReference::inline(goal, planner, answer, RecedingSettings::default())
}

/// As for an autopilot's own loop.
fn cautious(goal: Trajectory) -> RecedingReference {
    let (planner, answer) = planner(physics());
    let settings = RecedingSettings::default().for_loop(true);
    RecedingReference::inline(goal, planner, answer, settings)
}

#[test]
fn replanning_recovers_from_a_kick() {
    let reference = inline(hover_at(0.0));
    let mut follower = Follower::hovering();
    follower.follow(&reference, 1.0);
    assert!(follower.state[0].abs() < 1e-2, "{:?}", follower.state);
    follower.state[3] += 0.6;
    follower.state[6] += 0.2;
    // The next plan begins at the vehicle's current state.
    follower.follow(&reference, 0.2);
    let now = reference.sample(follower.time());
    let here = state_of(&follower.state);
    assert!((now.position - here.position).norm() < 0.03, "{now:?} {here:?}");
    assert!((now.velocity - here.velocity).norm() < 0.3, "{now:?} {here:?}");
    // Inputs alone lead back, because every plan starts from the observed state.
    follower.follow(&reference, 3.0);
    let s = &follower.state;
    assert!(s[0].hypot(s[1]) < 0.03 && (s[2] + 1.0).abs() < 0.03, "{s:?}");
}

#[test]
fn lagging_vehicle_returns_without_oscillation() {
    for delay in [2, 6] {
        let reference = late(hover_at(0.0), f64::from(delay) * PERIOD_S);
        let mut follower = Follower { delay: delay as usize, ..Follower::hovering() };
        follower.follow(&reference, 1.0);
        follower.state[3] += 0.6;
        follower.follow(&reference, 3.0);
        // Each plan accounts for the setpoints in transit, so the oscillation has ended.
        for _ in 0..10 {
            follower.follow(&reference, 0.1);
            let s = &follower.state;
            assert!(s[0].hypot(s[1]) < 0.03 && s[3].abs() < 0.05, "{delay} ticks: {s:?}");
        }
    }
}

#[test]
fn estimator_noise_is_hardly_followed() {
    let reference = cautious(hover_at(0.0));
    let mut follower = Follower::hovering();
    let mut random = Pcg64Mcg::seed_from_u64(1);
    let (mut squares, mut count, mut most) = (0.0, 0.0, 0.0_f64);
    for _ in 0..40 {
        let mut noise = |size: f64| size * random.random_range(-1.0..1.0);
        follower.follow_seen(&reference, 0.1, |state| {
            let mut seen = *state;
            for (i, size) in [0.01, 0.05, 0.01, 0.05].into_iter().enumerate() {
                seen[3 * i..3 * i + 3].iter_mut().for_each(|value| *value += noise(size));
            }
            seen
        });
        let sent = reference.sample(follower.time()).feedforward.attitude;
        squares += sent.roll.powi(2) + sent.pitch.powi(2);
        count += 2.0;
        most = most.max(follower.state[0].hypot(follower.state[1]));
    }
    let tilt = (squares / count).sqrt();
    assert!(tilt < 0.1, "{tilt} rad are commanded");
    // No feedback holds the vehicle here, and plans leave errors within the knee to feedback.
    assert!(most < 0.25, "{most} m from the goal");
}

#[test]
fn cautious_plan_corrects_only_large_errors() {
    let reference = cautious(hover_at(0.0));
    let mut follower = Follower::hovering();
    follower.follow(&reference, 1.0);
    follower.state[0] += 0.1;
    follower.follow(&reference, 0.3);
    assert!(reference.sample(follower.time()).position.north().abs() < 0.01);
    follower.state[0] += 0.5;
    follower.follow(&reference, 0.3);
    let now = reference.sample(follower.time()).position.north();
    assert!((0.2..0.5).contains(&now), "{now} m");
    follower.follow(&reference, 4.0);
    let s = &follower.state;
    assert!(s[0].hypot(s[1]) < 0.25 && s[3].hypot(s[4]) < 0.05, "{s:?}");
}

#[test]
fn desired_position_is_the_goal_despite_replanning() {
    let reference = inline(hover_at(0.5));
    let mut follower = Follower::hovering();
    follower.follow(&reference, 0.3);
    let t = follower.time();
    let here = state_of(&follower.state).position;
    assert!((reference.sample(t).position - here).norm() < 0.05);
    assert_eq!(reference.desired(t), Ned::new(0.5, 0.0, -1.0));
}

#[test]
fn moved_goal_is_followed_within_a_fraction_of_a_second() {
    let reference = inline(hover_at(0.0));
    let mut follower = Follower::hovering();
    follower.follow(&reference, 1.0);
    reference.goal().move_to(hover_at(0.5));
    follower.follow(&reference, 0.3);
    assert!(follower.state[3] > 0.1, "it is on its way: {:?}", follower.state);
    follower.follow(&reference, 3.0);
    let s = &follower.state;
    assert!((s[0] - 0.5).abs() < 0.03 && s[1].abs() < 0.03, "{s:?}");
}

/// A model that answers only once the gate is open.
struct Held {
    model: Arc<dyn Model>,
    gate: Mutex<Receiver<()>>,
    entered: Sender<()>,
}

impl Held {
    fn wait(&self) {
        let _ = self.entered.send(());
        // Opens once the test drops the sender.
        let _ = self.gate.lock().map(|gate| gate.recv());
    }
}

impl Model for Held {
    fn accelerations(&self, at: &Point) -> [f64; ACCELERATIONS] {
        self.wait();
        self.model.accelerations(at)
    }

    fn linearize(&self, at: &Point) -> ([f64; ACCELERATIONS], Jacobian) {
        self.wait();
        self.model.linearize(at)
    }
}

#[test]
fn late_planner_falls_back_to_the_goal_without_blocking() {
    let (open, gate) = channel();
    let (entered, planning) = channel();
    let held = Held { model: physics(), gate: Mutex::new(gate), entered };
    let (planner, answer) = planner(Arc::new(held));
    let settings = RecedingSettings::default();
    let reference =
        RecedingReference::threaded(hover_at(0.25), planner, answer, settings).expect("a thread");
    let hover = state_of(&Follower::hovering().state);
    reference.observe(0.0, &hover);
    planning.recv().expect("the planner is at work");
    // The planner is blocked: ticks continue, one observation waits, and more are dropped.
    for tick in 0..200 {
        let t = f64::from(tick) * PERIOD_S;
        reference.observe(t, &hover);
        let now = reference.sample(t);
        assert_eq!(now.position, Ned::new(0.25, 0.0, -1.0));
        assert!(now.feedforward.is_finite());
    }
    drop(open);
}

/// A model that fails.
struct Broken;

impl Model for Broken {
    fn accelerations(&self, _: &Point) -> [f64; ACCELERATIONS] {
        [f64::NAN; ACCELERATIONS]
    }

    fn linearize(&self, _: &Point) -> ([f64; ACCELERATIONS], Jacobian) {
        ([f64::NAN; ACCELERATIONS], [[f64::NAN; 13]; ACCELERATIONS])
    }
}

#[test]
fn failed_plans_are_not_flown() {
    let (planner, answer) = planner(Arc::new(Broken));
    let reference =
        RecedingReference::inline(hover_at(0.0), planner, answer, RecedingSettings::default());
    let hover = state_of(&Follower::hovering().state);
    for tick in 0..100 {
        let t = f64::from(tick) * PERIOD_S;
        reference.observe(t, &hover);
        let now = reference.sample(t);
        assert_eq!(now.position, Ned::new(0.0, 0.0, -1.0));
        assert!(now.feedforward.is_finite());
    }
}

#[test]
fn new_flight_starts_without_old_plans() {
    let reference = inline(hover_at(0.0));
    let mut follower = Follower::hovering();
    follower.follow(&reference, 1.0);
    let mut again = Follower::hovering();
    again.state[0] = 0.4;
    again.follow(&reference, 0.02);
    // Nothing of the first flight carries over: this flight's first plan begins after the lead.
    assert_eq!(reference.sample(0.0).position, Ned::new(0.0, 0.0, -1.0));
    again.follow(&reference, 3.0);
    assert!(again.state[0].abs() < 0.03, "{:?}", again.state);
}

/// The vehicle is at its goal, but its estimate says that it falls. A first plan, which has no
/// predecessor, would use full thrust to correct that, unless it is cautious.
#[test]
fn first_cautious_plan_leaves_small_errors_to_feedback() {
    let most = |receding: RecedingSettings| {
        let (planner, answer) = planner(physics());
        let hover_n = planner.hover_thrust_n();
        let reference = RecedingReference::inline(hover_at(0.0), planner, answer, receding);
        let mut seen = [0.0; 12];
        (seen[2], seen[5]) = (-1.03, 0.25);
        reference.observe(0.0, &state_of(&seen));
        let excess = |k: u32| {
            let sent = reference.sample(f64::from(k) * PERIOD_S).feedforward;
            (sent.thrust_n / hover_n - 1.0).abs()
        };
        (5..50).map(excess).fold(0.0, f64::max)
    };
    let plain = most(RecedingSettings::default());
    let cautious = most(RecedingSettings::default().for_loop(true));
    assert!(plain > 0.1 && cautious < 0.01, "{plain} and {cautious} of the weight");
}
