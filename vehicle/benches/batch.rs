//! Vehicle steps per second of a batch on one core, for `benches/peers/run plant`.
//!
//! `taskset -c 1 cargo bench -p downwash-vehicle --bench batch -- [VEHICLES]` prints one JSON object a line: of
//! each set of vector instructions that this processor has, in single and double precision, without an effect,
//! with a lag of the rotors, with every effect but gusts, and with every effect. The figure is the best of
//! several short runs: others on the machine only ever take time away.

mod every_effect;

use std::hint::black_box;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use vehicle::VehicleParams;
use vehicle::batch::{Batch, Precision, Width};
use vehicle::effects::EffectSet;
use vehicle::frame::Frd;
use vehicle::plant::Setup;
use vehicle::rigid_body::State;

use self::every_effect::EVERY_EFFECT;

/// Vehicles, where no other number is given.
const VEHICLES: usize = 1024;
/// Runs of which the best counts, and how long each is.
const RUNS: usize = 15;
const RUN: Duration = Duration::from_millis(30);

fn main() {
    // Cargo passes a flag of its own.
    let count = std::env::args().skip(1).find_map(|word| word.parse().ok()).unwrap_or(VEHICLES);
    for width in Width::available() {
        measure::<f32>(width, "f32", count);
        measure::<f64>(width, "f64", count);
    }
}

fn measure<F: Precision>(width: Width, precision: &str, count: usize) {
    let but_gusts: Vec<&str> =
        EVERY_EFFECT.into_iter().filter(|effect| !effect.starts_with("gusts")).collect();
    for (what, lag, effects) in [
        ("no effects", 0.0, &[][..]),
        ("motor lag", 0.03, &[]),
        ("every effect but gusts", 0.03, &but_gusts),
        ("every effect", 0.03, &EVERY_EFFECT),
    ] {
        let rate = steps_per_second(&mut batch::<F>(width, lag, effects, count), count);
        println!(
            "{{\"tool\": \"downwash\", \"precision\": \"{precision}\", \"instructions\": \"{}\", \
             \"what\": \"{what}\", \"vehicles\": {count}, \"steps_per_s\": {rate:.0}}}",
            width.name()
        );
    }
}

fn batch<F: Precision>(width: Width, lag: f64, effects: &[&str], count: usize) -> Batch<F> {
    let file = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../config/vehicles/quad1200.toml");
    let mut vehicle = VehicleParams::load(file).expect("the shipped vehicle file is valid");
    vehicle.modelled_effects = EffectSet::new();
    vehicle.motor_time_constant_s = lag;
    let mut set = EffectSet::new();
    for effect in effects {
        set.insert_argument(effect).expect("the effects above are valid");
    }
    let setup = Setup { floor_down_m: 1e9, ..Setup::default() };
    let batch = Batch::<F>::new(&vehicle, &set, &setup, 1, count).expect("a valid vehicle");
    batch.at_most(width)
}

/// RK4 vehicle steps per second, each with a row of outputs of its own as a controller gives it.
fn steps_per_second<F: Precision>(batch: &mut Batch<F>, count: usize) -> f64 {
    let start = State {
        velocity: [1.0, -2.0, 3.0].into(),
        body_rate: Frd::new(0.3, -0.2, 0.5),
        ..State::default()
    };
    let outputs = vec![[0.5, 0.49, 0.5, 0.51].map(F::from_f64); count];
    let mut best: f64 = 0.0;
    for _ in 0..RUNS {
        // Sinking and turning again, so that every effect is at work.
        (0..count).for_each(|index| batch.set(index, start, [0.5; 4]));
        let (began, mut steps) = (Instant::now(), 0);
        while began.elapsed() < RUN {
            (0..16).for_each(|_| batch.step(black_box(&outputs), 1));
            steps += 16 * count;
        }
        best = best.max(steps as f64 / began.elapsed().as_secs_f64());
    }
    best
}
