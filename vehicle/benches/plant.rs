//! Steps of the plant per second on one core: one vehicle for many steps, and many in turn or together.
//!
//! `cargo bench -p downwash-vehicle --bench plant`, pinned to one core for steady numbers.

mod every_effect;

use std::hint::black_box;
use std::path::PathBuf;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use vehicle::VehicleParams;
use vehicle::batch::{Batch, Precision};
use vehicle::effects::EffectSet;
use vehicle::frame::Frd;
use vehicle::plant::{Plant, Setup};
use vehicle::rigid_body::State;

use self::every_effect::EVERY_EFFECT;

const STEPS: u64 = 1000;
/// Vehicles in a fleet.
const FLEET: usize = 1000;

fn parts(lag: f64, effects: &[&str]) -> (VehicleParams, EffectSet, Setup) {
    let file = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../config/vehicles/quad1200.toml");
    let mut vehicle = VehicleParams::load(file).expect("the shipped vehicle file is valid");
    vehicle.modelled_effects = EffectSet::new();
    vehicle.motor_time_constant_s = lag;
    let mut set = EffectSet::new();
    for effect in effects {
        set.insert_argument(effect).expect("the effects above are valid");
    }
    (vehicle, set, Setup { floor_down_m: 1e9, ..Setup::default() })
}

fn plant(lag: f64, effects: &[&str]) -> Plant {
    let (vehicle, set, setup) = parts(lag, effects);
    Plant::new(&vehicle, &set, &setup, 1).expect("the shipped vehicle's mixer can be inverted")
}

fn steps(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("plant_steps");
    group.throughput(Throughput::Elements(STEPS));
    for (name, lag, effects) in [
        ("no_effects", 0.0, &[][..]),
        ("motor_lag", 0.03, &[]),
        ("every_effect", 0.03, &EVERY_EFFECT),
    ] {
        let start = plant(lag, effects);
        group.bench_function(name, |bencher| {
            bencher.iter_batched_ref(
                || {
                    let mut plant = start.clone();
                    // Sinking and turning, so that every effect is at work.
                    let velocity = [1.0, -2.0, 3.0].into();
                    let body_rate = Frd::new(0.3, -0.2, 0.5);
                    plant.set_state(State { velocity, body_rate, ..*plant.state() });
                    plant
                },
                |plant| {
                    for _ in 0..STEPS {
                        plant.step(black_box([0.5, 0.49, 0.5, 0.51]));
                    }
                    *plant.state()
                },
                criterion::BatchSize::SmallInput,
            );
        });
    }
    group.finish();
}

/// As in a swarm or a search over parameters: the vehicles do not fit into the nearest cache.
fn fleet(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("fleet_steps");
    group.throughput(Throughput::Elements(FLEET as u64));
    for (name, effects) in [("no_effects", &[][..]), ("every_effect", &EVERY_EFFECT)] {
        let mut fleet = vec![plant(0.0, effects); FLEET];
        group.bench_function(name, |bencher| {
            bencher.iter(|| {
                for plant in &mut fleet {
                    plant.step(black_box([0.5; 4]));
                }
            });
        });
    }
    group.finish();
}

/// As fleets, but stepped together; each row of outputs for one step, as a controller gives them.
fn batch<F: Precision>(criterion: &mut Criterion, precision: &str) {
    let mut group = criterion.benchmark_group(format!("batch_steps_{precision}"));
    group.throughput(Throughput::Elements(FLEET as u64));
    let without_gusts: Vec<&str> =
        EVERY_EFFECT.into_iter().filter(|effect| !effect.starts_with("gusts")).collect();
    for (name, lag, effects) in [
        ("no_effects", 0.0, &[][..]),
        ("motor_lag", 0.03, &[]),
        ("every_effect_but_gusts", 0.03, &without_gusts),
        ("every_effect", 0.03, &EVERY_EFFECT),
    ] {
        let (vehicle, set, setup) = parts(lag, effects);
        let mut batch = Batch::<F>::new(&vehicle, &set, &setup, 1, FLEET).expect("as a plant");
        let velocity = [1.0, -2.0, 3.0].into();
        let state = State { velocity, body_rate: Frd::new(0.3, -0.2, 0.5), ..State::default() };
        for index in 0..FLEET {
            batch.set(index, state, [0.5; 4]);
        }
        let outputs = vec![[0.5, 0.49, 0.5, 0.51].map(F::from_f64); FLEET];
        group.bench_function(name, |bencher| {
            bencher.iter(|| batch.step(black_box(&outputs), 1));
        });
    }
    group.finish();
}

fn batches(criterion: &mut Criterion) {
    batch::<f32>(criterion, "f32");
    batch::<f64>(criterion, "f64");
}

criterion_group!(benches, steps, fleet, batches);
criterion_main!(benches);
