//! Feedback without steady-state error: vehicles that differ from their file, each flown with the
//! paper's feedback and with the disturbance observer, with setpoints as for a PX4.

use std::sync::Arc;

use crate::lockstep;
use crate::lockstep::{
    Bench, NANO, QUAD, SLOW, VEHICLES, errors, fly, hover, params, setpoint_frames, settings,
    toml_trajectory, tracked, trajectory,
};
use downwash::control::{Limits, Use};
use downwash::log::record::Record;
use downwash::model::physics::{PhysicsModel, PhysicsParameters};
use downwash::offboard::EffectiveVehicle;
use downwash::plan::Trajectory;
use downwash::plan::planned::Answer;
use downwash::plan::planner::{PlanSettings, PlannedVehicle, Planner};
use downwash::plan::receding::{RecedingReference, RecedingSettings};
use downwash::station::{End, StationSettings};
use downwash::supervisor::{EngagePolicy, FlightState};
use sitl::autopilot::Mode;
use sitl::config::{Autopilot, SitlConfig};
use vehicle::VehicleParams;

/// For an autopilot that does not report accepting attitude, rates and thrust together.
fn with(offset_free: Use, params: &VehicleParams, trajectory: Trajectory) -> StationSettings {
    let mut settings = settings(params, trajectory);
    settings.session.vehicle_has_attitude_pd = false;
    settings.offboard.offset_free.observer = offset_free;
    settings.offboard.offset_free.feed_forward = offset_free;
    settings
}

/// RMS distance from the reference from the eighth second on, m.
fn late_error_m(
    offset_free: Use,
    params: &VehicleParams,
    trajectory: &Trajectory,
    effects: &[&str],
    seed: u64,
) -> f64 {
    let settings = with(offset_free, params, trajectory.clone());
    let (end, records) = fly(settings, params, effects, SitlConfig::default(), seed);
    assert_eq!(end, End::Done, "{} {effects:?}", params.name);
    let late: Vec<f64> =
        tracked(&records).iter().filter(|row| row.t > 8.0).map(|row| row.error_m).collect();
    (late.iter().map(|error| error * error).sum::<f64>() / late.len() as f64).sqrt()
}

/// Ways in which a vehicle may differ from its file.
fn disturbances(params: &VehicleParams) -> [String; 6] {
    [
        format!("mass:mass_kg={}", 1.2 * params.mass),
        "attitude_trim:roll_rad=0.05,pitch_rad=-0.04".to_owned(),
        "com_offset:x_m=0.002,y_m=-0.001".to_owned(),
        "thrust_scale:scale=0.85".to_owned(),
        "thrust_curve:a=0.3".to_owned(),
        "wind:north_m_s=3.0,east_m_s=-4.0".to_owned(),
    ]
}

#[test]
fn no_disturbance_leaves_a_steady_state_error() {
    for name in VEHICLES {
        let params = params(name);
        for effect in disturbances(&params) {
            // The nano's file has no drag for a wind to act on.
            if name == NANO && effect.starts_with("wind") {
                continue;
            }
            let paper = late_error_m(Use::Off, &params, &hover(15.0), &[effect.as_str()], 1);
            let free = late_error_m(Use::On, &params, &hover(15.0), &[effect.as_str()], 1);
            assert!(paper > 0.015, "{name} {effect}: {paper} m");
            assert!(free < 0.01, "{name} {effect}: {free} m");
        }
    }
}

#[test]
fn turning_circle_is_tracked_under_every_disturbance() {
    for name in VEHICLES {
        let params = params(name);
        let drag = format!("rotor_drag:d_xy={},d_z=0.0", params.mass);
        let circle = trajectory("sinusoid-yaw.toml");
        let paper = late_error_m(Use::Off, &params, &circle, &[], 1);
        assert!(paper > 0.2, "{name}: {paper} m");
        for effect in disturbances(&params).iter().chain([&drag]) {
            let free = late_error_m(Use::On, &params, &circle, &[effect.as_str()], 1);
            assert!(free < 0.06, "{name} {effect}: {free} m");
        }
    }
}

#[test]
fn lagging_vehicle_settles_for_every_seed() {
    for name in VEHICLES {
        let params = params(name);
        for seed in 1..5 {
            let settings = with(Use::On, &params, hover(12.0));
            let (end, records) = fly(settings, &params, &SLOW, SitlConfig::default(), seed);
            assert_eq!(end, End::Done, "{name} {seed}");
            let (_, largest) = errors(&records);
            let rows = tracked(&records);
            let late = rows.iter().filter(|row| row.t > 8.0);
            let shaking = late.map(|row| row.state.body_rate.norm()).fold(0.0, f64::max);
            assert!(largest < 0.1 && shaking < 0.5, "{name} {seed}: {largest} m, {shaking} rad/s");
        }
    }
}

/// The setpoints' frames, byte by byte.
fn sent(settings: StationSettings, params: &VehicleParams) -> Vec<Vec<u8>> {
    let (end, records) = fly(settings, params, &[], SitlConfig::default(), 1);
    assert_eq!(end, End::Done);
    setpoint_frames(&records)
}

#[test]
fn bundled_vehicle_uses_the_papers_feedback_by_default() {
    let params = params(NANO);
    let flown = |offset_free: Use| {
        let mut settings = settings(&params, hover(2.0));
        settings.offboard.offset_free.observer = offset_free;
        settings.offboard.offset_free.feed_forward = offset_free;
        sent(settings, &params)
    };
    let by_default = flown(Use::Auto);
    assert!(by_default == flown(Use::Off));
    assert!(by_default != flown(Use::On));
}

#[test]
fn autopilot_with_its_own_loop_is_offset_free_by_default() {
    let params = params(NANO);
    let flown = |offset_free: Use| sent(with(offset_free, &params, hover(2.0)), &params);
    assert!(flown(Use::Auto) == flown(Use::On));
}

#[test]
fn saturated_thrust_causes_no_windup() {
    // Three metres up at once with a thrust limit that leaves little for climbing, and down again.
    let steps = toml_trajectory(
        "family = \"waypoints\"\npace = { speed_m_s = 3.0, acceleration_m_s2 = 6.0 }\n\
         points = [{ north_m = 0, east_m = 0, altitude_m = 1, hold_s = 4 }, \
         { north_m = 0, east_m = 0, altitude_m = 4, hold_s = 8 }]",
    );
    let params = params(QUAD);
    let mut settings = with(Use::On, &params, steps);
    settings.offboard.limits.thrust_max = 0.6;
    let (end, records) =
        fly(settings, &params, &["thrust_scale:scale=0.9"], SitlConfig::default(), 1);
    assert_eq!(end, End::Done);
    let rows = tracked(&records);
    let limited = rows.iter().filter(|row| row.saturation & 1 != 0).count();
    let highest = rows.iter().map(|row| -row.state.position.down()).fold(0.0, f64::max);
    assert!(limited > 20, "{limited} ticks at the limit");
    assert!(highest < 4.25, "overshoot to {highest} m");
}

#[test]
fn pilot_takeover_resets_the_disturbance_estimate() {
    let params = params(QUAD);
    let mut settings = with(Use::On, &params, hover(60.0));
    settings.policy = EngagePolicy::PilotSwitch;
    settings.search_timeout_s = None;
    let effects = ["wind:north_m_s=4.0,east_m_s=0.0,down_m_s=0.0"];
    let mut bench = Bench::with(settings, &params, &effects, SitlConfig::default());
    bench.engage();
    bench.run(5.0);
    let tilt = |bench: &Bench| {
        let last = bench.records.iter().rev().find_map(|record| match record {
            Record::Tick(tick) => tick.setpoint.map(|setpoint| setpoint.attitude.pitch),
            _ => None,
        });
        last.expect("a setpoint")
    };
    assert!(tilt(&bench) > 0.05, "leans against a wind to the north: {}", tilt(&bench));
    // The pilot holds position, then returns control.
    bench.pilot_mode(Mode::Position);
    bench.run(6.0);
    bench.records.clear();
    bench.pilot_mode(Mode::Offboard);
    bench.until(FlightState::Track, 30.0);
    let ticks = bench.records.iter().filter_map(|record| match record {
        Record::Tick(tick) => Some(tick),
        _ => None,
    });
    let first = ticks.filter(|tick| tick.setpoint.is_some() && tick.phase == "approach").take(2);
    for tick in first {
        assert!(tick.feedback.thrust_n.abs() < 0.05 * 1.2 * 9.81, "{:?}", tick.feedback);
    }
    bench.run(8.0);
    let rows = tracked(&bench.records);
    let last = rows.last().expect("tracked");
    assert!(last.error_m < 0.05, "{} m", last.error_m);
}

/// A planner that uses the physics of the vehicle file, and the vehicle's response.
fn nominal(params: &VehicleParams) -> (Planner, Answer) {
    let attitude_pd = params.attitude_pd.expect("a loop");
    let body = EffectiveVehicle::new(params).expect("a vehicle").body();
    let answer = Answer {
        delay_s: params.command_delay_s,
        lag_s: params.motor_time_constant_s,
        voltage_exponent: 0.0,
        attitude_pd,
    };
    let model = PhysicsModel::new(params, &PhysicsParameters::default()).expect("physics");
    let vehicle = PlannedVehicle { body, attitude_pd, limits: Limits::default() };
    let planner = Planner::new(Arc::new(model), vehicle, PlanSettings::default());
    (planner.expect("a planner"), answer)
}

#[test]
fn drag_known_to_the_plan_is_not_compensated_twice() {
    let mut params = params(QUAD);
    let drag = format!("rotor_drag:d_xy={},d_z=0.11", 0.8 * params.mass);
    params.modelled_effects = lockstep::effects(&[drag.as_str()]);
    let (planner, answer) = nominal(&params);
    let circle = toml_trajectory(
        "family = \"sinusoid-yaw\"\naltitude_m = 1.0\nduration_s = 5.0\namplitude_m = 1.0\n\
         period_s = 5.0\nyaw_period_s = 10.0",
    );
    let flown = |observer: Use| {
        let mut settings = with(observer, &params, circle.clone());
        let receding = RecedingSettings::default();
        settings.reference =
            Arc::new(RecedingReference::inline(circle.clone(), planner.clone(), answer, receding));
        let (end, records) = fly(settings, &params, &[], SitlConfig::default(), 1);
        assert_eq!(end, End::Done);
        errors(&records).0
    };
    let (alone, observed) = (flown(Use::Off), flown(Use::On));
    assert!(alone < 0.06 && observed < alone + 0.01, "{alone} m, observed {observed} m");
}

#[test]
fn replanning_tracks_a_circle_with_a_wandering_estimate() {
    let mut params = params(QUAD);
    (params.command_delay_s, params.motor_time_constant_s) = (0.02, 0.06);
    let (planner, answer) = nominal(&params);
    let circle = trajectory("sinusoid-yaw.toml");
    let receding = RecedingSettings::default().for_loop(true);
    let mut settings = with(Use::On, &params, circle.clone());
    settings.reference =
        Arc::new(RecedingReference::inline(circle.clone(), planner, answer, receding));
    let mut config = SitlConfig { autopilot: Autopilot::Px4, ..SitlConfig::default() };
    config.estimator.wander_m = 0.1;
    config.estimator.velocity_wander_m_s = 0.16;
    let (end, records) = fly(settings, &params, &SLOW, config, 1);
    assert_eq!(end, End::Done);
    let mut errors = Vec::new();
    for record in &records {
        let Record::Tick(tick) = record else { continue };
        let (Some(desired), Some(_)) = (tick.desired, tick.trajectory_time) else { continue };
        errors.push((tick.state.position - desired).norm());
    }
    let square: f64 = errors.iter().map(|error| error * error).sum();
    let rms = (square / errors.len() as f64).sqrt();
    let cut = tracked(&records).iter().filter(|row| row.saturation != 0).count();
    assert!(rms < 0.15, "{rms} m from the circle");
    assert!(cut * 20 < errors.len(), "{cut} of {} setpoints at a limit", errors.len());
}

#[test]
fn quickened_feedback_tracks_wandering_estimates_and_circles_better() {
    let mut params = params(QUAD);
    (params.command_delay_s, params.motor_time_constant_s) = (0.02, 0.04);
    let mut config = SitlConfig { autopilot: Autopilot::Px4, ..SitlConfig::default() };
    config.estimator.wander_m = 0.1;
    config.estimator.velocity_wander_m_s = 0.16;
    let late = ["motor_lag:tau_s=0.04", "command_delay:delay_s=0.02"];
    let flown = |quicken: Use, offset_free: Use, trajectory: Trajectory| {
        let mut settings = with(offset_free, &params, trajectory);
        settings.control.quicken = quicken;
        let (end, records) = fly(settings, &params, &late, config.clone(), 1);
        assert_eq!(end, End::Done);
        errors(&records).0
    };
    for (offset_free, trajectory) in
        [(Use::On, hover(15.0)), (Use::Off, trajectory("sinusoid-yaw.toml"))]
    {
        let [plain, quick] =
            [Use::Off, Use::On].map(|quicken| flown(quicken, offset_free, trajectory.clone()));
        assert!(quick < 0.8 * plain, "{quick} m quickened, {plain} m as set");
    }
}
