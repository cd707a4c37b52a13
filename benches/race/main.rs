//! The fastest way through the 19-waypoint course on which published planners are compared: its
//! flight time, and the single-core planning time; and the published results under the same judge.
//!
//! `cargo bench --bench race -- [--published DIR] [--repeats 5]`
//!
//! DIR holds the trajectories from FSC-Lab/TOGT-Planner at 6707d3a (`resources/trajectory`):
//! `aos_traj.csv` and `aos_refined_traj.csv`. Without it, only this repository's plans are judged.

#[allow(dead_code, reason = "the tests use all of it")]
#[path = "../../tests/race_course.rs"]
mod race_course;
#[allow(dead_code, reason = "the tests use all of it")]
#[path = "../../tests/race_judge.rs"]
mod race_judge;

use std::path::{Path, PathBuf};

use downwash::plan::time_optimal::{Settings, Stop, TimeOptimal, plan};

use rustix::time::{ClockId, clock_gettime};

use race_course as course;
use race_judge as judge;
use race_judge::{JudgedInput, JudgedState, JudgedVehicle, Verdict};

/// Number of waypoints of the whole course.
const WHOLE: usize = 19;

fn main() {
    let mut published: Option<PathBuf> = None;
    let mut repeats = 5;
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            "--published" => published = arguments.next().map(PathBuf::from),
            "--repeats" => {
                repeats = arguments.next().and_then(|text| text.parse().ok()).unwrap_or(repeats);
            }
            _ => {}
        }
    }
    println!("flight (s)  planning (s)  thrust over (N)  rate over (rad/s)  miss (m)  end off (m)");
    if let Some(folder) = &published {
        for name in ["aos_traj", "aos_refined_traj"] {
            match read(&folder.join(format!("{name}.csv"))) {
                Ok(flight) => print(name, None, &judge_published(&flight)),
                Err(reason) => eprintln!("{name}: {reason}"),
            }
        }
    }
    let coarse = Settings::default();
    let fine = Settings { periods: 16, refinements: 1, tolerance_s: 1e-4, ..coarse };
    let tight = [15.0, 15.0, 0.3];
    for (name, waypoints, is_level, rates, settings) in [
        ("7 waypoints, to a hover", 7, true, course::RATES, coarse),
        ("19 waypoints, to a hover", WHOLE, true, course::RATES, coarse),
        ("19 waypoints, to rest", WHOLE, false, course::RATES, coarse),
        ("19, to a hover, refined", WHOLE, true, course::RATES, fine),
        ("19, to rest, refined", WHOLE, false, course::RATES, fine),
        ("19, to rest, yaw 0.3 rad/s", WHOLE, false, tight, fine),
    ] {
        let vehicle = course::vehicle();
        let physics = course::physics(&vehicle);
        let limits = course::limits(rates);
        let course = course::course(waypoints, is_level);
        let mut times = Vec::new();
        let mut found: Option<TimeOptimal> = None;
        for _ in 0..repeats.max(1) {
            let began_s = core_s();
            found = Some(plan(&course, &physics, &limits, &settings, Stop::NEVER));
            times.push(core_s() - began_s);
        }
        times.sort_by(f64::total_cmp);
        let Some(found) = found else { continue };
        let body = course::judged_vehicle(&vehicle);
        let (start, inputs) = course::judged_flight(&vehicle, &found.knots);
        let states = judge::fly(&body, start, &inputs);
        let verdict = judge::judge(
            &states,
            &inputs,
            &course::judged_limits(&vehicle, &limits),
            &course::judged_passages(&course),
        );
        print(name, times.get(times.len() / 2).copied(), &verdict);
    }
}

/// CPU time of this process, which plans on one thread, s: other load on the machine does not
/// count.
fn core_s() -> f64 {
    let time = clock_gettime(ClockId::ProcessCPUTime);
    time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64
}

fn print(name: &str, planning_s: Option<f64>, verdict: &Verdict) {
    let end_off = verdict.end.map_or(f64::NAN, |end| {
        let squares = (0..3).map(|i| (end.place[i] - course::FINISH[i]).powi(2));
        squares.sum::<f64>().sqrt()
    });
    println!(
        "{:10.3}  {:>12}  {:15.1e}  {:17.1e}  {:8.1e}  {end_off:11.1e}  {name}",
        verdict.duration,
        planning_s.map_or("-".to_owned(), |s| format!("{s:.3}")),
        verdict.thrust_excess,
        verdict.rate_excess,
        verdict.miss(),
    );
}

/// States, and the thrusts held from each to the next.
struct Flight {
    states: Vec<JudgedState>,
    inputs: Vec<JudgedInput>,
}

/// Judges a flight by its own states; between them by its inputs, from each state on.
fn judge_published(flight: &Flight) -> Verdict {
    let course = course::course(WHOLE, true);
    let vehicle = course::vehicle();
    let limits = course::judged_limits(&vehicle, &course::limits(course::RATES));
    let body = published_vehicle();
    let mut states = Vec::new();
    for (state, input) in flight.states.iter().zip(&flight.inputs) {
        let mut between = judge::fly(&body, *state, std::slice::from_ref(input));
        between.pop();
        states.extend(between);
    }
    states.extend(flight.states.last());
    judge::judge(&states, &flight.inputs, &limits, &course::judged_passages(&course))
}

/// The rotors in the order of the published files: front right, rear left, rear right, front left.
fn published_vehicle() -> JudgedVehicle {
    let arm = 0.15 * std::f64::consts::FRAC_1_SQRT_2;
    JudgedVehicle {
        arms: [[arm, -arm], [-arm, arm], [-arm, -arm], [arm, arm]],
        yaw: [-0.05, -0.05, 0.05, 0.05],
        ..course::judged_vehicle(&course::vehicle())
    }
}

fn read(path: &Path) -> Result<Flight, String> {
    let text = std::fs::read_to_string(path).map_err(|error| error.to_string())?;
    let mut lines = text.lines();
    let head: Vec<&str> = lines.next().unwrap_or_default().split(',').collect();
    let names = [
        "t", "p_x", "p_y", "p_z", "v_x", "v_y", "v_z", "q_w", "q_x", "q_y", "q_z", "w_x", "w_y",
        "w_z", "u_1", "u_2", "u_3", "u_4",
    ];
    let mut columns = Vec::new();
    for name in names {
        let column = head.iter().position(|found| *found == name);
        columns.push(column.ok_or(format!("no column {name}"))?);
    }
    let mut rows: Vec<Vec<f64>> = Vec::new();
    for line in lines {
        let cells: Vec<&str> = line.split(',').collect();
        let number = |column: &usize| {
            let cell = cells.get(*column).ok_or("a row is short")?;
            cell.parse::<f64>().map_err(|error| error.to_string())
        };
        rows.push(columns.iter().map(number).collect::<Result<_, String>>()?);
    }
    let part = |row: &[f64], from: usize| [row[from], row[from + 1], row[from + 2]];
    let states = rows.iter().map(|row| JudgedState {
        t: row[0],
        place: part(row, 1),
        velocity: part(row, 4),
        attitude: [row[7], row[8], row[9], row[10]],
        rate: part(row, 11),
    });
    let inputs = rows.windows(2).map(|pair| JudgedInput {
        thrusts: [pair[0][14], pair[0][15], pair[0][16], pair[0][17]],
        held: pair[1][0] - pair[0][0],
    });
    Ok(Flight { states: states.collect(), inputs: inputs.collect() })
}
