//! Speed of the controller: its design, and one tick of feedback and limits.

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use downwash::clock::VehicleTime;
use downwash::control::{
    Actuation, Adaptation, AdaptationSettings, AttitudeError, AttitudeLoop, ControlSettings,
    Controller, DisturbanceObserver, HoverModel, HoverVehicle, Limits, Lqr, OffsetFreeSettings,
    solve_dare,
};
use downwash::setpoint::{Expected, Reference, Setpoint, State};
use vehicle::frame::{Euler, Ned};

const VEHICLE: HoverVehicle =
    HoverVehicle { mass_kg: 0.0343, inertia: [1.67e-5, 1.74e-5, 3.15e-5], gravity: 9.81 };
const PD: AttitudeLoop =
    AttitudeLoop::Pd { kp: [0.00524, 0.00549, 0.00242], kd: [0.000508, 0.000534, 0.000525] };

fn control(c: &mut Criterion) {
    let settings = ControlSettings::default();
    let model = HoverModel::continuous(&VEHICLE, &PD).discretised(0.01);
    let (q, r) = settings.weights(VEHICLE.hover_thrust_n());
    c.bench_function("riccati_12_states_7_inputs", |b| {
        b.iter(|| solve_dare(black_box(&model.state), &model.input, &q, &r));
    });
    c.bench_function("lqr_design", |b| {
        b.iter(|| Lqr::design(black_box(&VEHICLE), &PD, &settings));
    });
    let lqr = Lqr::design(&VEHICLE, &PD, &settings).expect("a stabilising gain");
    let state = State {
        position: Ned::new(0.1, -0.2, -1.1),
        attitude: Euler::new(0.05, -0.03, 1.2).attitude(),
        ..State::default()
    };
    let (reference, limits) = (Reference::default(), Limits::default());
    c.bench_function("feedback_and_limits", |b| {
        b.iter(|| {
            let (feedback, _) = lqr.feedback(black_box(&state), &reference);
            limits.apply(reference.feedforward.plus(feedback), 0.66, 1.2)
        });
    });
}

/// One tick of the controller alone, with the observer, and with adapted parameters.
fn adaptation(c: &mut Criterion) {
    let lqr = Lqr::design(&VEHICLE, &PD, &ControlSettings::default()).expect("a stabilising gain");
    let observer = || {
        DisturbanceObserver::new(
            OffsetFreeSettings::default(),
            VEHICLE,
            PD,
            AttitudeError::Angles,
            Actuation { command_delay_s: 0.005, motor_time_constant_s: 0.04 },
        )
    };
    let adapting = || observer().adapting(Adaptation::new(AdaptationSettings::default()), false);
    let (expected, reference) = (Expected::default(), Reference::default());
    let sent = Setpoint { thrust_n: VEHICLE.hover_thrust_n(), ..Setpoint::default() };
    for (name, observer) in
        [("law", None), ("observer", Some(observer())), ("adaptation", Some(adapting()))]
    {
        let mut controller = Controller::from(lqr.clone()).observing(observer);
        controller.sent(Some(sent));
        let mut tick = 0;
        c.bench_function(&format!("tick_with_{name}"), |b| {
            b.iter(|| {
                tick += 1;
                // A noise with a period of a prime number of ticks.
                let noise = 1e-2 * (f64::from(tick * 79 % 101) / 50.0 - 1.0);
                let velocity = Ned::new(noise, -noise, noise);
                let state = State { velocity, ..State::default() };
                let at = VehicleTime::from_ms(10 * tick);
                controller.observe(at, &state, &expected, false, 1.0);
                controller.command(f64::from(tick) * 0.01, black_box(&state), &reference)
            });
        });
    }
}

criterion_group!(benches, control, adaptation);
criterion_main!(benches);
