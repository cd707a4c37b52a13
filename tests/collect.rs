//! `downwash collect` in simulation: kinds of flight, limits, resuming, reproducible bytes.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use downwash::log::LogReader;
use downwash::log::schema::TruthMessage;
use downwash::plan::Trajectory;
use serde_json::Value;

/// A folder that is removed after the test.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("downwash-{name}-{}", std::process::id()));
        fs::create_dir_all(&path).expect("a folder");
        Self(path)
    }

    fn logs(&self) -> BTreeMap<String, Vec<u8>> {
        let entries = fs::read_dir(&self.0).expect("the folder");
        let log = |path: PathBuf| {
            let name = path.file_name().expect("a name").to_string_lossy().into_owned();
            (name, fs::read(&path).expect("a log"))
        };
        entries.map(|entry| log(entry.expect("an entry").path())).collect()
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

fn collect(out: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_downwash"))
        .env("XDG_CONFIG_HOME", out)
        .arg("collect")
        .arg("--out")
        .arg(out)
        .arg("--json")
        .args(arguments)
        .output()
        .expect("the command runs")
}

fn summary(output: &Output) -> Value {
    serde_json::from_slice(&output.stdout).unwrap_or_else(|error| {
        panic!("{error}: {}", String::from_utf8_lossy(&output.stderr));
    })
}

fn column<'a>(summary: &'a Value, name: &str) -> Vec<&'a str> {
    let flights = summary["flights"].as_array().expect("flights");
    flights.iter().map(|flight| flight[name].as_str().expect("a text")).collect()
}

#[test]
fn all_kinds_are_flown_once_and_truncated_flights_again() {
    let (two, one) = (Folder::new("collect-two"), Folder::new("collect-one"));
    let short = ["--seconds", "60", "--effect", "rotor_drag:d_xy=0.012,d_z=0.008"];
    let output = collect(&two.0, &[&short[..], &["--jobs", "2"]].concat());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let first = summary(&output);
    assert_eq!(
        column(&first, "kind"),
        ["sinusoid-xy", "sinusoid-xz", "sinusoid-yz", "yaw-rotation", "unstructured"]
    );
    assert!(column(&first, "end").iter().all(|end| *end == "done"));
    let samples = first["samples"].as_u64().expect("a count");
    assert!((6000..6020).contains(&samples), "{samples}");

    // The logs do not depend on the order or the number of threads.
    assert!(collect(&one.0, &[&short[..], &["--jobs", "1"]].concat()).status.success());
    let logs = two.logs();
    assert_eq!(logs.len(), 5);
    assert!(logs == one.logs(), "the same arguments give the same bytes");
    for name in logs.keys() {
        keeps_to_the_box(&two.0.join(name));
    }

    // A truncated log is replaced; the others are kept.
    let (name, bytes) = logs.iter().nth(3).expect("a log");
    fs::write(two.0.join(name), &bytes[..bytes.len() / 2]).expect("cut");
    let again = summary(&collect(&two.0, &short));
    assert_eq!(column(&again, "end"), ["kept", "kept", "kept", "done", "kept"]);
    assert_eq!(again["samples"], first["samples"]);
    assert!(two.logs() == logs, "the truncated flight is complete again");

    // A different truth is a different programme: the first one's files stay untouched.
    let other = summary(&collect(&two.0, &["--seconds", "60", "--seed", "2"]));
    assert!(column(&other, "end").iter().all(|end| *end == "done"));
    assert_eq!(two.logs().len(), 10);
}

/// The vehicle stays near the box, upright and above the floor, on the trajectory and off it.
fn keeps_to_the_box(log: &Path) {
    let mut reader = LogReader::open(log).expect("a log");
    let mut samples = 0;
    while let Some(message) = reader.next_message().expect("readable") {
        let Some(truth) = message.decode::<TruthMessage>() else { continue };
        samples += 1;
        assert!(truth.p_n_m.abs() < 2.6 && truth.p_e_m.abs() < 2.6, "{}", log.display());
        assert!((-3.0..0.05).contains(&truth.p_d_m), "{}: {}", log.display(), truth.p_d_m);
        let tilt_cos = 1.0 - 2.0 * (truth.q_x.powi(2) + truth.q_y.powi(2));
        assert!(tilt_cos > 40f64.to_radians().cos(), "{}", log.display());
    }
    assert!(samples > 1000);
    assert!(reader.run().contains_key("battery_charge"));
    assert_eq!(reader.attachments().iter().filter(|a| a.name.contains("crazyflie")).count(), 1);
}

#[test]
fn early_end_is_reported_and_its_log_kept() {
    let folder = Folder::new("collect-early");
    let output =
        collect(&folder.0, &["--seconds", "60", "--effect", "rotor_loss:rotor=0,scale=0.3"]);
    assert_eq!(output.status.code(), Some(5), "{}", String::from_utf8_lossy(&output.stderr));
    let ends = summary(&output);
    assert!(column(&ends, "end").iter().any(|end| end.starts_with("ended early: ")));
    assert_eq!(folder.logs().len(), 5);
}

#[test]
fn write_trajectories_writes_files_without_flying() {
    let folder = Folder::new("collect-files");
    let files = folder.0.join("files");
    let to = files.to_string_lossy().into_owned();
    let arguments = ["--seconds", "120", "--combined", "30", "--write-trajectories", &to];
    let listed = summary(&collect(&folder.0, &arguments));
    let names = column(&listed, "name");
    assert_eq!(names.len(), 8);
    for name in names {
        let trajectory = Trajectory::load(&files.join(format!("{name}.toml"))).expect("flyable");
        assert!(trajectory.duration() > 4.0);
    }
    assert_eq!(fs::read_dir(&folder.0).expect("the folder").count(), 1);
}

#[test]
fn too_short_programme_is_refused() {
    let folder = Folder::new("collect-short");
    let output = collect(&folder.0, &["--seconds", "5"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&output.stderr).contains("at least 32 s"));
}
