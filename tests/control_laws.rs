//! Every control law in flight: each family of trajectories in lockstep, and recovery from nearly
//! upside down.

use crate::lockstep::{
    NANO, QUAD, VEHICLES, errors, fly, hover, ideal, params, settings, trajectory,
};
use crate::lockstep_autopilots::set_up;
use downwash::control::{
    Actuation, AttitudeLoop, ControlProblem, ControlSettings, Controller, HoverVehicle, LAWS, Law,
    Limits, Use,
};
use downwash::setpoint::{Reference, Setpoint, State};
use downwash::station::End;
use sitl::autopilot::offboard::AttitudeSetpoint;
use sitl::autopilot::pd::AttitudeLoop as OnboardLoop;
use sitl::config::{Autopilot, SitlConfig};
use vehicle::effects::EffectSet;
use vehicle::frame::{Euler, Ned};
use vehicle::plant::Plant;
use wire::dialect::AttitudeTargetTypemask;

/// The shipped trajectories, one of each family, and the largest RMS error that feedback alone may
/// leave, m.
const FAMILIES: [(&str, f64); 9] = [
    ("hover.toml", 0.05),
    ("sinusoid-xy.toml", 0.6),
    ("sinusoid-xz.toml", 0.6),
    ("sinusoid-yz.toml", 0.6),
    ("sinusoid-yaw.toml", 0.6),
    ("yaw-rotation.toml", 0.05),
    ("figure-8.toml", 0.6),
    ("steps.toml", 1.0),
    ("random-waypoints.toml", 0.6),
];

/// The flights of the default law, the LQR, are in `lockstep_flight.rs`.
#[test]
fn every_law_flies_every_family_of_trajectories() {
    for vehicle in VEHICLES {
        let params = params(vehicle);
        for (name, most_m) in FAMILIES {
            let others = LAWS.into_iter().filter(|&spec| Law::new(spec) != Law::LQR);
            let fly_with = |spec| {
                let mut settings = settings(&params, trajectory(name));
                settings.control.law = Law::new(spec);
                let (end, records) = fly(settings, &params, &[], SitlConfig::default(), 1);
                assert_eq!(end, End::Done, "{vehicle}, {name}, {}", spec.id);
                let (rms_m, _) = errors(&records);
                assert!(rms_m < most_m, "{vehicle}, {name}, {}: {rms_m} m", spec.id);
                rms_m
            };
            let found: Vec<f64> = others.map(fly_with).collect();
            println!("{vehicle:16} {name:24} {found:.4?}");
        }
    }
}

/// The disturbance observer works around any law. The steady error is compared with that of the LQR
/// without an observer, because an adaptive law already removes most of it.
#[test]
fn observer_compensates_unknown_weight_under_every_law() {
    let params = params(NANO);
    let mut plain = None;
    for spec in LAWS {
        let flown = |observer| {
            let mut settings = settings(&params, hover(15.0));
            settings.control.law = Law::new(spec);
            settings.offboard.offset_free.observer = observer;
            let mass = ["mass:mass_kg=0.033"];
            let (end, records) = fly(settings, &params, &mass, ideal(), 1);
            assert_eq!(end, End::Done, "{}", spec.id);
            errors(&records).0
        };
        let (without, with) = (flown(Use::Off), flown(Use::On));
        println!("{}: {without} m without, {with} m with", spec.id);
        let plain = *plain.get_or_insert(without);
        // Two estimators of the same error share it and settle later.
        let most = if without < 0.5 * plain { 0.3 } else { 0.1 };
        assert!(with < most * plain, "{}: {with} of {plain}", spec.id);
    }
}

/// An autopilot's own loop takes only attitude and thrust.
#[test]
fn every_law_flies_px4_and_arducopter() {
    let params = params(QUAD);
    for name in [Autopilot::Px4, Autopilot::Arducopter] {
        for spec in LAWS {
            let mut settings = settings(&params, trajectory("figure-8.toml"));
            settings.control.law = Law::new(spec);
            let (end, records) = fly(settings, &params, &[], set_up(name), 1);
            assert_eq!(end, End::Done, "{name:?}, {}", spec.id);
            let (rms_m, _) = errors(&records);
            println!("{name:?} {} {rms_m}", spec.id);
            assert!(rms_m < 0.3, "{name:?}, {}: {rms_m} m", spec.id);
        }
    }
}

/// The state after falling from rest at a roll of 170 degrees, and the depth of the fall, m.
fn recovered(vehicle: &str, law: Law) -> (State, f64) {
    let params = params(vehicle);
    let config = ideal();
    let mut plant =
        Plant::new(&params, &EffectSet::new(), &config.plant(), 1).expect("a plant").airborne();
    let constants = plant.physics().constants();
    let thrust_full_n: f64 = constants.rotors.iter().map(|rotor| rotor.thrust_max).sum();
    let hover = HoverVehicle {
        mass_kg: constants.mass,
        inertia: constants.inertia,
        gravity: params.gravity,
    };
    let actuation =
        Actuation { command_delay_s: 0.0, motor_time_constant_s: constants.motor_time_constant };
    let pd = params.attitude_pd.expect("a loop");
    let limits = Limits::default();
    let mut controller = Controller::design(&ControlProblem {
        vehicle: &hover,
        actuation: &actuation,
        attitude_loop: &AttitudeLoop::from(pd),
        limits: &limits,
        settings: &ControlSettings { law, ..ControlSettings::default() },
    })
    .expect("a law");
    let onboard = OnboardLoop::new(pd, params.allocation().expect("a mixer"));
    let start = Ned::new(0.0, 0.0, -30.0);
    plant.set_rotor_states([params.hover_thrust; 4]);
    plant.set_state(State {
        position: start,
        attitude: Euler::new(170.0_f64.to_radians(), 0.0, 0.5).attitude(),
        ..State::default()
    });
    let attitude = Euler::new(0.0, 0.0, 0.5);
    let feedforward =
        Setpoint { thrust_n: hover.hover_thrust_n(), attitude, ..Setpoint::default() };
    let reference = Reference { position: start, attitude, feedforward, ..Reference::default() };
    let (mut outputs, mut sent, mut deepest) = ([params.hover_thrust; 4], None, 0.0_f64);
    for ms in 0..12_000 {
        let state = *plant.state();
        deepest = deepest.max(state.position.down() - start.down());
        if ms % 10 == 0 {
            let command = controller.command(f64::from(ms) * 1e-3, &state, &reference);
            let yaw = state.attitude.yaw();
            let (setpoint, _) = limits.apply(command.setpoint, thrust_full_n, yaw).expect("finite");
            sent = Some(AttitudeSetpoint {
                attitude: Some(setpoint.attitude),
                body_rate: setpoint.body_rate,
                thrust: setpoint.thrust_n / thrust_full_n,
                type_mask: AttitudeTargetTypemask::empty(),
            });
        }
        if ms % 4 == 0
            && let Some(sent) = &sent
        {
            outputs = onboard.outputs(sent, state.attitude.euler(), state.body_rate);
        }
        while plant.time() < f64::from(ms + 1) * 1e-3 - 1e-6 {
            plant.step(outputs);
        }
    }
    (*plant.state(), deepest)
}

#[test]
fn geometric_law_recovers_from_170_degrees_roll_better_than_lqr() {
    for vehicle in VEHICLES {
        let (end, geometric_m) = recovered(vehicle, Law::GEOMETRIC);
        let (_, lqr_m) = recovered(vehicle, Law::LQR);
        println!("{vehicle}: {geometric_m:.2} m deep, the LQR {lqr_m:.2} m");
        let off = (end.position - Ned::new(0.0, 0.0, -30.0)).norm();
        assert!(off < 0.05 && end.velocity.norm() < 0.05, "{vehicle}: {end:?}");
        assert!(end.attitude.tilt() < 0.02, "{vehicle}: {end:?}");
        assert!(geometric_m < lqr_m, "{vehicle}: {geometric_m} m and {lqr_m} m");
    }
}
