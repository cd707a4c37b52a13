//! Replanning in flight: the time of a plan that continues the previous one, and whether a
//! fixed-rate loop waits for it.
//!
//! `cargo bench --bench replan -- --model model.safetensors [--hybrid] [--vehicle crazyflie]
//! [--rate 200] [--seconds 60] [--subproblems 1] [--damping 0.5] [--states 100]`
//!
//! The vehicle is the model itself, moved by the plan's inputs and shaken at random. It flies
//! `sinusoid-yaw` repeatedly, and its only feedback is a plan of 100 states over 1 s at each tick.
//! The time of each plan is the thread's CPU time. A tick is late if its plan is ready only after
//! the next tick is due, by CPU time or by the wall clock; for comparison, the bench counts how
//! often an idle loop of the same period wakes as late.

use std::path::PathBuf;
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};

use downwash::control::Limits;
use downwash::model::Model;
use downwash::model::file::{ModelFile, ModelKind};
use downwash::model::physics::{PhysicsModel, PhysicsParameters};
use downwash::offboard::EffectiveVehicle;
use downwash::plan::Trajectory;
use downwash::plan::discretisation::{CommandedDynamics, Dynamics};
use downwash::plan::planned::Answer;
use downwash::plan::planner::{PlanSettings, PlannedVehicle, Planner};
use downwash::plan::receding::{RecedingReference, RecedingSettings};
use downwash::plan::reference::ReferenceSource;
use downwash::setpoint::State;
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use rustix::time::{ClockId, clock_gettime};
use vehicle::VehicleParams;
use vehicle::frame::{Euler, Frd, Ned, wrap_angle};

/// Random disturbance of the vehicle per second: m/s^2 and rad/s^2.
const SHAKE: [f64; 2] = [1.0, 5.0];

struct Arguments {
    model: Option<PathBuf>,
    kind: ModelKind,
    vehicle: PathBuf,
    rate_hz: f64,
    seconds: f64,
    subproblems: usize,
    states_hz: f64,
    damping: f64,
}

fn arguments() -> Arguments {
    let mut given = Arguments {
        model: None,
        kind: ModelKind::Net,
        vehicle: "crazyflie".into(),
        rate_hz: 200.0,
        seconds: 60.0,
        subproblems: 1,
        states_hz: 100.0,
        damping: 0.5,
    };
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        let mut number = || words.next().and_then(|text| text.parse::<f64>().ok());
        match word.as_str() {
            "--rate" => given.rate_hz = number().unwrap_or(given.rate_hz),
            "--seconds" => given.seconds = number().unwrap_or(given.seconds),
            "--subproblems" => given.subproblems = number().map_or(1, |count| count as usize),
            "--hybrid" => given.kind = ModelKind::Hybrid,
            "--damping" => given.damping = number().unwrap_or(given.damping),
            "--states" => given.states_hz = number().unwrap_or(100.0),
            "--model" => given.model = words.next().map(PathBuf::from),
            "--vehicle" => given.vehicle = words.next().map_or(given.vehicle, PathBuf::from),
            _ => {}
        }
    }
    given
}

fn main() {
    let given = arguments();
    let vehicle = VehicleParams::load(&given.vehicle).expect("a vehicle file");
    let attitude_pd = vehicle.attitude_pd.expect("an attitude loop");
    let (model, name): (Arc<dyn Model>, _) = match &given.model {
        Some(path) => {
            let file = ModelFile::load(path).expect("a model");
            let model = file.model(given.kind).expect("a model of this vehicle");
            (model.into(), format!("{} of {}", given.kind.name(), path.display()))
        }
        None => {
            let physics = PhysicsModel::new(&vehicle, &PhysicsParameters::default());
            (Arc::new(physics.expect("physics")), "the vehicle file's physics".to_owned())
        }
    };
    let planned = PlannedVehicle {
        body: EffectiveVehicle::new(&vehicle).expect("a vehicle").body(),
        attitude_pd,
        limits: Limits::default(),
    };
    let period = 1.0 / given.rate_hz;
    let receding = RecedingSettings {
        period_s: 0.9 * period,
        lead_s: 0.0,
        horizon_s: 100.0 / given.states_hz,
        subproblems_max: given.subproblems,
        damping: given.damping,
        ..RecedingSettings::default()
    };
    let settings = PlanSettings { rate_hz: given.states_hz, receding, ..PlanSettings::default() };
    let planner = Planner::new(Arc::clone(&model), planned, settings).expect("a planner");
    let text = format!(
        "family = 'sinusoid-yaw'\naltitude_m = 1\nduration_s = {}\namplitude_m = 1\n\
         period_s = 5\nyaw_period_s = 10\nramp_s = 0.5",
        given.seconds + 2.0
    );
    let goal = Trajectory::parse(&text, &PathBuf::from("sinusoid")).expect("a trajectory");
    let first = goal.sample(0.0);
    let answer = Answer { delay_s: 0.0, lag_s: 0.0, voltage_exponent: 0.0, attitude_pd };
    let reference = RecedingReference::inline(goal, planner, answer, receding);

    let dynamics = CommandedDynamics::new(model.as_ref(), attitude_pd, period);
    let mut random = Pcg64Mcg::seed_from_u64(1);
    let mut state = [0.0; 12];
    state[..3].copy_from_slice(&first.position.to_array());
    let ticks = (given.seconds * given.rate_hz) as usize;
    let (mut used, mut waited, mut miss) =
        (Vec::with_capacity(ticks), Vec::with_capacity(ticks), 0.0);
    let mut due = Instant::now();
    let every = Duration::from_secs_f64(period);
    for tick in 0..ticks {
        due += every;
        let t = tick as f64 * period;
        let seen = typed(&state);
        let before = clock_gettime(ClockId::ThreadCPUTime);
        reference.observe(t, &seen);
        let after = clock_gettime(ClockId::ThreadCPUTime);
        used.push(
            (after.tv_sec - before.tv_sec) as f64 + (after.tv_nsec - before.tv_nsec) as f64 * 1e-9,
        );
        waited.push(Instant::now().saturating_duration_since(due).as_secs_f64());
        miss += (seen.position - reference.desired(t)).norm().powi(2);
        // The plan's input acts until the next tick.
        let sent = reference.sample(t).feedforward;
        let Euler { roll, pitch, yaw } = sent.attitude;
        // The dynamics do not wrap yaw's difference.
        let yaw = state[8] + wrap_angle(yaw - state[8]);
        let [p, q, r] = sent.body_rate.to_array();
        state = dynamics.step(&state, &[sent.thrust_n, roll, pitch, yaw, p, q, r]);
        for (value, size) in state[3..6].iter_mut().zip([SHAKE[0]; 3]) {
            *value += random.random_range(-size..size) * period;
        }
        for (value, size) in state[9..].iter_mut().zip([SHAKE[1]; 3]) {
            *value += random.random_range(-size..size) * period;
        }
        thread::sleep(due.saturating_duration_since(Instant::now()));
    }
    // The first plan has no predecessor, and is searched to its end.
    let (first_s, mut used) = (used[0], used.split_off(1));
    waited.remove(0);
    let idle = idle(ticks.min(20_000), every);
    let late = |times: &[f64], beyond: f64| times.iter().filter(|time| **time > beyond).count();
    println!("{ticks} plans of 100 states at {} Hz through {name}", given.rate_hz);
    println!(
        "CPU time of the first plan {:.0} ms, of each other {}",
        1e3 * first_s,
        row(&mut used)
    );
    println!("off the trajectory: {:.4} m RMS", (miss / ticks as f64).sqrt());
    println!("plans longer than the period by CPU time: {}", late(&used, period));
    println!(
        "plans that were ready after the next tick was due, by the wall clock: {}",
        late(&waited, 0.0)
    );
    println!(
        "an idle loop of {} ticks beside it woke later than a period: {}",
        idle.len(),
        late(&idle, period)
    );
}

/// Wake-up delays of a loop that does nothing, s.
fn idle(ticks: usize, every: Duration) -> Vec<f64> {
    let mut due = Instant::now();
    (0..ticks)
        .map(|_| {
            due += every;
            thread::sleep(due.saturating_duration_since(Instant::now()));
            Instant::now().saturating_duration_since(due).as_secs_f64()
        })
        .collect()
}

fn row(times: &mut [f64]) -> String {
    times.sort_by(f64::total_cmp);
    let at = |share: f64| 1e3 * times[((times.len() - 1) as f64 * share) as usize];
    format!(
        "p50 {:.3} ms, p90 {:.3} ms, p99 {:.3} ms, most {:.3} ms",
        at(0.5),
        at(0.9),
        at(0.99),
        at(1.0)
    )
}

fn typed(state: &[f64; 12]) -> State {
    let [n, e, d, vn, ve, vd, roll, pitch, yaw, p, q, r] = *state;
    State {
        position: Ned::new(n, e, d),
        velocity: Ned::new(vn, ve, vd),
        attitude: Euler::new(roll, pitch, yaw).attitude(),
        body_rate: Frd::new(p, q, r),
    }
}
