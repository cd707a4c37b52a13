//! Time-optimal plans: closed forms, limits checked by an independent judge, gates, regions, and
//! refusals.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use crate::lockstep;
use crate::planning::{attitude_pd, vehicle as crazyflie};
use crate::race_course::{
    RATES, course, judged_flight, judged_limits, judged_passages, judged_vehicle, limits, physics,
    vehicle,
};
use crate::race_judge::{JudgedState, Verdict, fly, judge};
use downwash::control;
use downwash::plan::keep_out::KeepOut;
use downwash::plan::planned::{Answer, Found, Plan, PlannedBody, PlannedReference, PlannedThrough};
use downwash::plan::planner::{KeepOutSetting, PlanSettings};
use downwash::plan::scp::Status;
use downwash::plan::time_optimal::{
    Course, Finish, FlightPlanner, Gate, Knots, Limits, NoWay, Passage, Settings, Start, Stop,
    Task, TimeOptimal, plan,
};
use downwash::plan::{FlightEnvelope, Trajectory, TrajectoryFile};
use downwash::station::End;
use vehicle::VehicleParams;
use vehicle::frame::Ned;

/// From rest to rest through passages, ending as a hover.
fn from_rest(from: Ned, passages: Vec<Passage>, to: Ned) -> Course {
    Course {
        start: Start { position: from, velocity: Ned::zero(), yaw: 0.0 },
        passages,
        finish: Finish { position: to, velocity: Ned::zero(), is_level: true },
        keep_out: Vec::new(),
        room: None,
    }
}

fn planned(course: &Course, vehicle: &VehicleParams, limits: &Limits) -> TimeOptimal {
    plan(course, &physics(vehicle), limits, &Settings::default(), Stop::NEVER)
}

fn judged(
    found: &TimeOptimal,
    course: &Course,
    vehicle: &VehicleParams,
    limits: &Limits,
) -> Verdict {
    let (start, inputs) = judged_flight(vehicle, &found.knots);
    let states = fly(&judged_vehicle(vehicle), start, &inputs);
    judge(&states, &inputs, &judged_limits(vehicle, limits), &judged_passages(course))
}

/// Checks that the judge finds limits and passages held to 1e-3, and the finish to a millimetre.
fn check(found: &TimeOptimal, course: &Course, vehicle: &VehicleParams, limits: &Limits) {
    assert_eq!(found.status, Status::Converged);
    let verdict = judged(found, course, vehicle, limits);
    assert!((verdict.duration - found.knots.duration_s()).abs() < 1e-9);
    assert!(verdict.thrust_excess <= 1e-9, "{verdict:?}");
    assert!(verdict.rate_excess <= 1e-3 * limits.body_rate_rad_s[0], "{verdict:?}");
    assert!(verdict.miss() <= 1e-3, "{verdict:?}");
    assert!(verdict.times.is_sorted());
    let end = verdict.end.expect("a flight");
    let [n, e, d] = course.finish.position.to_array();
    for (found, wanted) in end.place.iter().zip([n, -e, -d]) {
        assert!((found - wanted).abs() < 1e-3, "{verdict:?}");
    }
    for (found, wanted) in end.velocity.iter().zip([0.0; 3]) {
        assert!((found - wanted).abs() < 1e-2, "{verdict:?}");
    }
}

#[test]
fn climb_time_matches_bang_bang_thrust() {
    let vehicle = vehicle();
    let limits = limits(RATES);
    let height = 6.0;
    let course = from_rest(Ned::zero(), Vec::new(), Ned::new(0.0, 0.0, -height));
    let found = planned(&course, &vehicle, &limits);
    check(&found, &course, &vehicle, &limits);
    // Up at F/m - g, then slowed by the weight alone.
    let up = 4.0 * 6.879 / 0.85 - vehicle.gravity;
    let down = vehicle.gravity;
    let speed = (2.0 * height / (1.0 / up + 1.0 / down)).sqrt();
    let exact = speed / up + speed / down;
    let time = found.knots.duration_s();
    assert!(time < 1.0 + exact && time > 0.5 * exact, "{time} {exact}");
    // Turning over and braking with thrust is faster than falling; level flight is not left here.
    let upright = Limits { tilt_rad: Some(0.01), ..limits };
    let found = planned(&course, &vehicle, &upright);
    let time = found.knots.duration_s();
    assert!((time / exact - 1.0).abs() < 2e-3, "{time} {exact}");
}

#[test]
fn level_flight_time_approaches_the_point_mass_bound() {
    let vehicle = vehicle();
    let course = from_rest(Ned::zero(), Vec::new(), Ned::new(40.0, 0.0, 0.0));
    let level = ((4.0 * 6.879 / 0.85_f64).powi(2) - vehicle.gravity.powi(2)).sqrt();
    let bound = 2.0 * (40.0 / level).sqrt();
    let times = [3.0, 6.0, 15.0].map(|rate| {
        let limits = limits([rate; 3]);
        let found = planned(&course, &vehicle, &limits);
        check(&found, &course, &vehicle, &limits);
        found.knots.duration_s()
    });
    assert!(times.is_sorted_by(|slow, quick| slow > quick), "{times:?}");
    assert!(times[2] > bound && times[2] < 1.15 * bound, "{times:?} {bound}");
}

#[test]
fn waypoints_are_passed_within_limits() {
    let vehicle = vehicle();
    let limits = limits(RATES);
    let course = course(4, true);
    let found = planned(&course, &vehicle, &limits);
    check(&found, &course, &vehicle, &limits);
}

#[test]
#[ignore = "long: tests/run --all"]
fn published_course_time_is_competitive() {
    let vehicle = vehicle();
    let limits = limits(RATES);
    for (is_level, most) in [(true, 17.61), (false, 17.57)] {
        let course = course(19, is_level);
        let found = planned(&course, &vehicle, &limits);
        check(&found, &course, &vehicle, &limits);
        // 17.93 s by sampling, 17.60 s refined, 17.56 s by CPC.
        assert!(found.knots.duration_s() < most, "{}", found.knots.duration_s());
    }
}

#[test]
#[ignore = "long: tests/run --all"]
fn sixty_waypoint_course_is_planned() {
    let vehicle = vehicle();
    let limits = limits(RATES);
    let course = course(60, true);
    let found = planned(&course, &vehicle, &limits);
    check(&found, &course, &vehicle, &limits);
}

#[test]
fn gates_are_passed_in_order_and_direction() {
    let vehicle = vehicle();
    let limits = limits(RATES);
    // Out and back through one opening: the second passage is in the opposite direction.
    let middle = Ned::new(5.0, 0.0, -2.0);
    let opening = [0.8, 0.8];
    let gates = [
        Gate::new(middle, 0.0, 0.0, opening),
        Gate::new(middle, std::f64::consts::PI, 0.0, opening),
        Gate::new(Ned::new(0.0, 4.0, -4.0), 0.5, 0.4, opening),
    ];
    let course = from_rest(
        Ned::new(0.0, 0.0, -2.0),
        gates.into_iter().map(Passage::Gate).collect(),
        Ned::new(4.0, 4.0, -2.0),
    );
    let found = planned(&course, &vehicle, &limits);
    check(&found, &course, &vehicle, &limits);
}

#[test]
fn regions_are_avoided_between_states_too() {
    let vehicle = vehicle();
    let limits = limits(RATES);
    let free = from_rest(Ned::zero(), Vec::new(), Ned::new(10.0, 0.0, 0.0));
    let pillar = KeepOut::Box { lower: Ned::new(4.8, -0.5, -9.0), upper: Ned::new(5.2, 0.8, 9.0) };
    let ball = KeepOut::Sphere { centre: Ned::new(7.5, -1.0, 0.0), radius: 0.8 };
    let course = Course { keep_out: vec![pillar, ball], ..free.clone() };
    let found = planned(&course, &vehicle, &limits);
    check(&found, &course, &vehicle, &limits);
    assert!(found.violation.trespass_m <= 1e-3, "{:?}", found.violation);
    // As seen by the judge, every millisecond.
    let (start, inputs) = judged_flight(&vehicle, &found.knots);
    for state in fly(&judged_vehicle(&vehicle), start, &inputs) {
        let [x, y, z] = state.place;
        let in_pillar = (4.801..5.199).contains(&x) && (-0.799..0.499).contains(&y);
        let from_ball = ((x - 7.5).powi(2) + (y - 1.0).powi(2) + z * z).sqrt();
        assert!(!in_pillar && from_ball > 0.799, "{state:?}");
    }
    let direct = planned(&free, &vehicle, &limits);
    assert!(found.knots.duration_s() > direct.knots.duration_s());
}

#[test]
fn time_scales_with_the_square_root_of_size() {
    let vehicle = vehicle();
    let course = course(2, true);
    let time = planned(&course, &vehicle, &limits(RATES)).knots.duration_s();
    // Everything four times as long, with the same mass: moments of inertia 16 times, rates half.
    let mut large = vehicle.clone();
    large.inertia = large.inertia.map(|moment| 16.0 * moment);
    for rotor in &mut large.rotors {
        rotor.position_m = rotor.position_m.map(|length| 4.0 * length);
        rotor.drag_torque_per_thrust_m *= 4.0;
    }
    let far = |place: Ned| place * 4.0;
    let mut wide = course.clone();
    wide.start.position = far(wide.start.position);
    wide.finish.position = far(wide.finish.position);
    for passage in &mut wide.passages {
        if let Passage::Waypoint { centre, tolerance_m } = passage {
            (*centre, *tolerance_m) = (far(*centre), 4.0 * *tolerance_m);
        }
    }
    let settings = Settings { length_min_s: 0.006, tolerance_s: 2e-3, ..Settings::default() };
    let rates = limits(RATES.map(|rate| 0.5 * rate));
    let found = plan(&wide, &physics(&large), &rates, &settings, Stop::NEVER);
    let ratio = found.knots.duration_s() / time;
    assert!((ratio - 2.0).abs() < 4e-3, "{ratio}");
}

#[test]
fn stopped_search_returns_its_best() {
    let vehicle = vehicle();
    let limits = limits(RATES);
    let course = course(3, true);
    let whole = planned(&course, &vehicle, &limits);
    let asked = AtomicUsize::new(0);
    let search = |_: &[_]| asked.fetch_add(1, Ordering::Relaxed) >= 12;
    let stop = Stop { search: &search, ..Stop::NEVER };
    let found = plan(&course, &physics(&vehicle), &limits, &Settings::default(), stop);
    assert_eq!(found.status, Status::Stopped);
    assert!(found.records.len() <= 12 + 60, "{}", found.records.len());
    assert!(found.knots.duration_s() > whole.knots.duration_s() - 1e-2);
    assert!(found.violation.defect < 1e-6, "{:?}", found.violation);
    // Stopped at once, it reports what it violates.
    let stop = Stop { search: &|_| true, closing: &|_| true };
    let found = plan(&course, &physics(&vehicle), &limits, &Settings::default(), stop);
    assert!(found.records.is_empty() && found.violation.defect > 1e-3, "{:?}", found.violation);
}

fn race() -> Task {
    match TrajectoryFile::load(Path::new("race")).expect("the shipped course") {
        TrajectoryFile::Task(task) => task,
        TrajectoryFile::Desired(_) => unreachable!("a course"),
    }
}

fn flight_planner(settings: PlanSettings) -> FlightPlanner {
    FlightPlanner {
        physics: physics(&crazyflie()),
        attitude_pd: attitude_pd(),
        lag_s: 0.04,
        limits: control::Limits::default(),
        envelope: FlightEnvelope::default(),
        settings,
    }
}

/// The shipped course's plan for the nano quadrotor, and the motion that it was made of.
fn race_plan(task: &Task, planner: &FlightPlanner) -> (Plan, Knots) {
    let planned = planner.plan(task, &task.margin, Stop::NEVER).expect("a plan");
    let vehicle = crazyflie();
    let thrust_full_n = vehicle.thrust_full_n();
    let desired = planned.outcome.iterate.states.clone();
    let plan = Plan::new(
        Found {
            trajectory: task.name.clone(),
            vehicle: vehicle.name.clone(),
            body: PlannedBody {
                mass_kg: vehicle.mass,
                inertia: vehicle.inertia,
                gravity: vehicle.gravity,
                thrust_full_n,
            },
            model: PlannedThrough { kind: "nominal".to_owned(), sha256: None },
            period_s: 0.01,
            answer: Answer {
                delay_s: 0.005,
                lag_s: 0.04,
                voltage_exponent: 0.0,
                attitude_pd: attitude_pd(),
            },
            desired,
        },
        planned.outcome,
    );
    (plan, planned.found.knots)
}

#[test]
fn shipped_course_gives_a_flyable_plan_that_passes_its_gates_in_flight() {
    let (task, vehicle) = (race(), crazyflie());
    let planner = flight_planner(PlanSettings::default());
    let (plan, knots) = race_plan(&task, &planner);
    plan.check_flyable().expect("a plan to fly");
    FlightEnvelope::default()
        .check_plan(&plan, vehicle.mass, vehicle.gravity)
        .expect("within the envelope");
    assert!((plan.duration() - knots.duration_s()).abs() < 0.011);
    // It ends at the finish, hovering.
    let last = plan.states.last().expect("states");
    let off: f64 = last[..3].iter().zip([0.0, 0.0, -1.0]).map(|(a, b)| (a - b).abs()).sum();
    assert!(off < 1e-2 && last[3..6].iter().all(|v| v.abs() < 0.1), "{last:?}");
    // Each rotor's thrust is that of the plan's wrench, within what the margin leaves.
    let limits = planner.limits(&task, &task.margin);
    for period in &knots.periods {
        for share in period.rotors {
            assert!((limits.rotor[0]..=limits.rotor[1]).contains(&share), "{share}");
        }
    }

    let mut settings = lockstep::settings(&vehicle, lockstep::hover(1.0));
    settings.reference = Arc::new(PlannedReference::new(&plan));
    let (end, records) = lockstep::fly(settings, &vehicle, &[], lockstep::ideal(), 1);
    assert_eq!(end, End::Done);
    let flown = lockstep::tracked(&records);
    let worst = flown.iter().map(|tick| tick.error_m).fold(0.0, f64::max);
    let states: Vec<JudgedState> = flown
        .iter()
        .map(|tick| {
            let [n, e, d] = tick.state.position.to_array();
            let place = [n, -e, -d];
            JudgedState {
                t: tick.t,
                place,
                velocity: [0.0; 3],
                attitude: [1.0, 0.0, 0.0, 0.0],
                rate: [0.0; 3],
            }
        })
        .collect();
    let course = task.course(Vec::new(), None).expect("a course");
    // Within the openings less their clearances, and the spheres, except for the tracking error.
    let verdict = judge(&states, &[], &judged_limits(&vehicle, &limits), &judged_passages(&course));
    assert!(verdict.miss() < 0.1, "{worst} {:?}", verdict.misses);
    assert!(verdict.times.is_sorted(), "{:?}", verdict.times);
}

#[test]
fn unreachable_place_is_named() {
    let region = KeepOutSetting::Sphere { centre_m: [2.2, 1.2, -1.6], radius_m: 0.5 };
    let settings = PlanSettings { keep_out: vec![region], ..PlanSettings::default() };
    let task = race();
    let refused = flight_planner(settings).plan(&task, &task.margin, Stop::NEVER);
    let expected = NoWay::KeptOut { place: "passages[1]".to_owned(), region: 0 };
    assert_eq!(refused.expect_err("no way"), expected);
    let settings = PlanSettings {
        box_m: Some([[-1.0, -3.0, -3.0], [3.0, 3.0, 0.0]]),
        ..PlanSettings::default()
    };
    let refused = flight_planner(settings).plan(&task, &task.margin, Stop::NEVER);
    assert_eq!(refused.expect_err("no way"), NoWay::OutOfBox { place: "passages[3]".to_owned() });
}

#[test]
fn invalid_course_files_are_refused_by_file_and_key() {
    let text = |passages: &str| {
        format!(
            "family = 'time-optimal'\nstart = {{ altitude_m = 1.0 }}\n\
             finish = {{ north_m = 2.0, altitude_m = 1.0 }}\n{passages}"
        )
    };
    let waypoint = |north: &str| {
        format!(
            "[[passages]]\nwaypoint = {{ north_m = {north}, east_m = 0.0, altitude_m = 1.0, \
             tolerance_m = 0.1 }}\n"
        )
    };
    let refused = |text: &str| {
        let error = TrajectoryFile::parse(text, Path::new("course.toml")).expect_err("refused");
        let error = error.to_string();
        assert!(error.contains("course.toml"), "{error}");
        error
    };
    let twice = refused(&text(&format!("{}{}", waypoint("1.0"), waypoint("1.0"))));
    assert!(twice.contains("passages[1] is at the same place as passages[0]"), "{twice}");
    let at_start = refused(&text(&waypoint("0.0")));
    assert!(at_start.contains("passages[0] is at the same place as start"), "{at_start}");
    let nowhere = text("").replace("north_m = 2.0, ", "");
    assert!(refused(&nowhere).contains("finish is at the same place as start"));
    assert!(refused(&text(&waypoint("nan"))).contains("north_m"));
    assert!(refused(&text(&waypoint("inf"))).contains("north_m"));
    assert!(refused(&text("[margin]\nthrust = 0.7\n")).contains("thrust"));
    assert!(refused(&text("[limits]\nspeed = 3.0\n")).contains("speed"));
    let narrow = "[[passages]]\ngate = { north_m = 1.0, east_m = 0.0, altitude_m = 1.0, \
                  heading_deg = 0.0, width_m = 0.4, height_m = 1.0, clearance_m = 0.2 }\n";
    assert!(refused(&text(narrow)).contains("width_m: expected more than twice the clearance_m"));
    // A course without passages leads from its start to its finish.
    assert!(TrajectoryFile::parse(&text(""), Path::new("course.toml")).is_ok());
}

#[test]
fn unplanned_course_is_refused_as_a_trajectory() {
    let error = Trajectory::load(Path::new("race")).expect_err("refused").to_string();
    assert!(error.contains("downwash plan race -o plan.json"), "{error}");
}
