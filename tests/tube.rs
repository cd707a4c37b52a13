//! `downwash tube`: a tube from simulated flights or logs, a plan that keeps the tube out of a
//! region, and flights that stay within the tube.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::Value;

/// A folder that is removed after the test.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("downwash-{name}-{}", std::process::id()));
        fs::create_dir_all(&path).expect("a folder");
        Self(path)
    }

    fn write(&self, name: &str, text: &str) {
        fs::write(self.0.join(name), text).expect("a file");
    }

    fn run(&self, arguments: &str) -> Output {
        Command::new(env!("CARGO_BIN_EXE_downwash"))
            .env("XDG_CONFIG_HOME", &self.0)
            .current_dir(&self.0)
            .args(arguments.split_whitespace())
            .output()
            .expect("the command runs")
    }

    fn json(&self, arguments: &str) -> Value {
        let output = self.run(arguments);
        serde_json::from_slice(&output.stdout)
            .unwrap_or_else(|error| panic!("{arguments}: {error}: {}", stderr(&output)))
    }

    fn read(&self, name: &str) -> Value {
        let text = fs::read_to_string(self.0.join(name)).expect("a file");
        serde_json::from_str(&text).expect("JSON")
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

const WAY: &str = "family = 'waypoints'\npace = { speed_m_s = 0.6, acceleration_m_s2 = 1.0 }\n\
    points = [{ north_m = 0, east_m = 0, altitude_m = 1 }, \
    { north_m = 2, east_m = 0, altitude_m = 1 }]";
const BALL: &str = "[plan]\ninput_weight = 0.05\n\
    keep_out = [{ sphere = { centre_m = [1.0, 0.15, -1.0], radius_m = 0.15 } }]\n";

/// A folder with a tube from `flights` and a plan around the ball with that tube.
fn planned(name: &str, flights: u32, confidence: f64) -> Folder {
    let folder = Folder::new(name);
    folder.write("way.toml", WAY);
    folder.write("ball.toml", BALL);
    let fit =
        folder.json(&format!("tube fit --along way.toml --flights {flights} -o tube.json --json"));
    assert_eq!(fit["flights"], flights);
    assert_eq!((&fit["ended_early"], &fit["position"]), (&Value::from(0), &Value::from("true")));
    let plan = folder.json(&format!(
        "plan way.toml --config ball.toml --tube tube.json --confidence {confidence} \
         -o plan.json --report report --json"
    ));
    assert_eq!(plan["not_flyable"], Value::Null, "{plan}");
    assert_eq!(plan["tube"]["margin_confidence"], f64::from(flights) / f64::from(flights + 1));
    folder
}

/// Checks that the plan stays its radius away from the ball.
fn keeps_away(plan: &Value) {
    let radii = plan["tube"]["radius_m"].as_array().expect("radii");
    let states = plan["states"].as_array().expect("states");
    assert_eq!(radii.len(), states.len());
    let mut nearest = f64::INFINITY;
    for (radius, state) in radii.iter().zip(states) {
        let at = |i: usize| state[i].as_f64().expect("a number");
        let off = (at(0) - 1.0).hypot(at(1) - 0.15).hypot(at(2) + 1.0);
        let radius = radius.as_f64().expect("a radius");
        assert!(radius > 0.005, "{radius}");
        nearest = nearest.min(off - 0.15 - radius);
    }
    // The margin covers the worst calibration flight and is wider than the tube.
    assert!((0.0..0.3).contains(&nearest), "{nearest} m between the tube and the ball");
    let confidence = |name: &str| plan["tube"][name].as_f64().expect("a probability");
    assert!(confidence("margin_confidence") > confidence("confidence"));
}

#[test]
fn plan_keeps_its_tube_clear_and_flights_stay_inside() {
    let folder = planned("tube-short", 24, 0.9);
    let plan = folder.read("plan.json");
    keeps_away(&plan);
    let check = folder.json("tube check plan.json --config ball.toml --flights 24 --seed 7 --json");
    // With a 90 % tube from 24 flights, fewer than 16 of 24 stay within by a chance of 0.5 %. The
    // seeds are fixed.
    let whole = check["whole"]["count"].as_u64().expect("a count");
    assert!(whole >= 16, "{check}");
    assert_eq!(check["touched"]["count"], 0, "{check}");
    assert_eq!((&check["regions"], &check["ended_early"]), (&Value::from(1), &Value::from(0)));
    let page = fs::read_to_string(folder.0.join("report/report.html")).expect("a report");
    assert!(page.contains("data-name=\"tube\"") && page.contains("radius (m)"));

    // The log of a flight has the radius with the reference, and its report draws it.
    let flight = folder.json("simulate plan.json --config ball.toml --out logs --json");
    let log = flight["log"].as_str().expect("a log");
    let page = fs::read_to_string(folder.0.join(log).with_extension("html")).expect("a report");
    assert!(page.contains("data-name=\"tube\""));
    let radii = logged_radii(&folder.0.join(log));
    let planned: Vec<f64> = plan["tube"]["radius_m"]
        .as_array()
        .expect("radii")
        .iter()
        .map(|radius| radius.as_f64().expect("a radius"))
        .collect();
    let most = |values: &[f64]| values.iter().copied().fold(0.0, f64::max);
    assert!(radii.len() > 200 && (most(&radii) - most(&planned)).abs() < 1e-3 * most(&planned));

    // `tube check` needs a plan with a tube, and a tube belongs to one vehicle.
    folder.json("plan way.toml -o bare.json --json");
    let refused = folder.run("tube check bare.json --flights 1");
    assert_eq!(refused.status.code(), Some(2));
    assert!(stderr(&refused).contains("the plan has no tube"), "{}", stderr(&refused));
    let refused = folder.run("plan way.toml --vehicle quad1200 --tube tube.json -o other.json");
    assert_eq!(refused.status.code(), Some(2));
    assert!(stderr(&refused).contains("make one for this vehicle"), "{}", stderr(&refused));
}

fn logged_radii(log: &Path) -> Vec<f64> {
    use downwash::log::LogReader;
    use downwash::log::schema::ReferenceMessage;
    let mut reader = LogReader::open(log).expect("a log");
    let mut radii = Vec::new();
    while let Some(message) = reader.next_message().expect("a message") {
        if let Some(reference) = message.decode::<ReferenceMessage>()
            && reference.tube_radius_m > 0.0
        {
            radii.push(reference.tube_radius_m);
        }
    }
    radii
}

#[test]
fn too_few_flights_are_refused_with_the_required_number() {
    let folder = Folder::new("tube-few");
    folder.write("way.toml", WAY);
    folder.json("plan way.toml -o plan.json --json");
    let mut logs = String::new();
    for seed in 1..=7 {
        let row = folder.json(&format!(
            "simulate plan.json --seed {seed} --effect wind:north_m_s={} --effect rotor_drag:d_xy=0.01 \
             --out logs-{seed} --no-report --json",
            0.2 * f64::from(seed) - 0.8
        ));
        logs += " ";
        logs += row["log"].as_str().expect("a log");
    }
    // Two of the seven logs give the shape.
    let fit = folder.json(&format!("tube fit{logs} -o tube.json --json"));
    assert_eq!((&fit["flights"], &fit["shape_flights"]), (&Value::from(5), &Value::from(2)));
    assert_eq!(fit["position"], "true");
    let refused = folder.run("plan way.toml --tube tube.json -o plan.json");
    assert_eq!(refused.status.code(), Some(2));
    let message = stderr(&refused);
    assert!(
        message.contains("5 calibration flights") && message.contains("at least 19"),
        "{message}"
    );
    let plan = folder.json("plan way.toml --tube tube.json --confidence 0.8 -o plan.json --json");
    assert!(plan["tube"]["radius_max_m"].as_f64().expect("a radius") > 0.0);
}

#[test]
#[ignore = "long: tests/run --all"]
fn promised_share_of_flights_stays_in_the_tube() {
    let folder = planned("tube-long", 500, 0.95);
    keeps_away(&folder.read("plan.json"));
    let check =
        folder.json("tube check plan.json --config ball.toml --flights 500 --seed 3 --json");
    let rate = check["whole"]["rate"].as_f64().expect("a rate");
    // About three standard deviations of 1.4 %, for calibration and count together.
    assert!((0.91..=0.99).contains(&rate), "{check}");
    assert_eq!(check["touched"]["count"], 0, "{check}");
}
