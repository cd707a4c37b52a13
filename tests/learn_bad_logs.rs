//! Damaged, foreign or too short logs among sound ones: `train` refuses or counts each defect by
//! name and learns from the rest.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use crate::{damage, learn, lockstep};
use downwash::log::import::{self, Flight, RotorFact, Stream};
use downwash::log::record::Record;
use serde_json::Value;
use sitl::config::SitlConfig;

static SOUND: LazyLock<Vec<PathBuf>> = LazyLock::new(|| learn::collect("sound", 40, &[]));

/// A flight of the same vehicle.
static RECORDS: LazyLock<Vec<Record>> = LazyLock::new(|| {
    let params = lockstep::params(lockstep::NANO);
    let settings = lockstep::settings(&params, lockstep::trajectory("sinusoid-xy.toml"));
    lockstep::fly(settings, &params, &learn::REALISTIC, SitlConfig::default(), 3).1
});

type Entries = Vec<(u64, Vec<u8>)>;

fn tlog(folder: &Path, name: &str, damage: impl FnOnce(&mut Entries)) -> PathBuf {
    let mut entries = damage::entries(&RECORDS);
    damage(&mut entries);
    let path = folder.join(name);
    damage::write_tlog(&path, &entries);
    path
}

fn file(folder: &Path, name: &str, content: &[u8]) -> PathBuf {
    let path = folder.join(name);
    fs::write(&path, content).expect("a file");
    path
}

/// Why a log was refused as a whole.
fn refusal<'a>(summary: &'a Value, name: &str) -> &'a str {
    let refused = summary["data"]["refused"].as_array().expect("refused logs");
    let found = refused.iter().find(|log| log["path"].as_str().expect("a path").ends_with(name));
    let found = found.unwrap_or_else(|| panic!("{name} is not refused: {refused:?}"));
    found["reason"].as_str().expect("a reason")
}

/// Why parts of a log were excluded, and how much.
fn left_out(summary: &Value, run: &str) -> String {
    let log = learn::logs(summary).iter().find(|log| log["run"] == run);
    log.unwrap_or_else(|| panic!("{run} is not used: {}", summary["data"]))["left_out"].to_string()
}

#[test]
fn defects_of_logs_are_reported_and_the_rest_is_used() {
    let folder = learn::folder("spoiled");
    let whole = fs::read(&SOUND[4]).expect("a log");
    let bad = [
        file(&folder, "empty.mcap", b""),
        file(&folder, "empty.tlog", b""),
        file(&folder, "garbage.mcap", &[0x55; 5000]),
        file(&folder, "garbage.tlog", &[0x55; 5000]),
        file(&folder, "twin.mcap", &fs::read(&SOUND[0]).expect("a log")),
        file(&folder, "table.csv", b"t,x\n0,1\n"),
        tlog(&folder, "short.tlog", |entries| {
            // Two seconds in the air.
            let (from, to) = (10_000_000, 12_000_000);
            let start = entries[0].0;
            entries.retain(|(time, _)| (from..to).contains(&(time - start)));
        }),
        changed(&folder, "turned.mcap", |flight| {
            flight.attitude = flight.attitude.map(|attitude| attitude.inverse());
        }),
    ];
    let spoiled = [
        file(&folder, "cut.mcap", &whole[..whole.len() * 2 / 3]),
        tlog(&folder, "nan.tlog", |entries| {
            let middle = entries.len() / 2;
            damage::spoil(entries, 31, middle, 400, f32::NAN);
        }),
        tlog(&folder, "double.tlog", |entries| {
            let doubled = entries.iter().enumerate().flat_map(|(number, entry)| {
                let times = if number % 7 == 0 { 2 } else { 1 };
                std::iter::repeat_n(entry.clone(), times)
            });
            *entries = doubled.collect();
        }),
        tlog(&folder, "jump.tlog", |entries| {
            let from = entries.len() * 2 / 3;
            damage::move_vehicle_clock(entries, from, 300_000);
        }),
        changed(&folder, "frozen.mcap", frozen),
    ];
    let logs = [SOUND.as_slice(), &bad, &spoiled].concat();
    let (output, model) = learn::train("spoiled-model", &logs, &[]);
    let summary = learn::summary(&output);
    assert!(model.exists());
    assert_eq!(summary["data"]["refused"].as_array().map(Vec::len), Some(bad.len()));
    assert_eq!(learn::logs(&summary).len(), SOUND.len() + spoiled.len());

    for (name, words) in [
        ("empty.mcap", "an empty file"),
        ("empty.tlog", "an empty file"),
        ("garbage.mcap", "garbage.mcap"),
        ("garbage.tlog", "not a flight log"),
        ("twin.mcap", "the same file as"),
        ("table.csv", "--mapping"),
        ("short.tlog", "is usable; at least"),
        ("turned.mcap", "attitude"),
    ] {
        assert!(refusal(&summary, name).contains(words), "{name}: {}", refusal(&summary, name));
    }
    assert!(refusal(&summary, "turned.mcap").starts_with("fault"), "as the audit says");
    for (run, words) in [
        ("cut", "cut"),
        ("nan", "ATTITUDE_QUATERNION"),
        ("double", "duplicated"),
        ("jump", "another run of the vehicle's clock"),
        ("frozen", "body rate: frozen"),
    ] {
        assert!(left_out(&summary, run).contains(words), "{run}: {}", left_out(&summary, run));
    }
    // The model is as good as from the sound logs alone.
    let physics = |kind| learn::number(&summary, &format!("/one_step/1/labels/2/{kind}"));
    assert!(physics("linear") < 0.02, "{}", summary["one_step"][1]);
    // Yaw hardly moves in most of these flights, so its label is mostly noise.
    for turn in ["each/3", "each/4"] {
        assert!(physics(turn) < 0.05, "{}", summary["one_step"][1]);
    }
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(bad.iter().all(|path| stderr.contains(&*path.to_string_lossy())), "{stderr}");
}

/// A sound log as a flight, changed and written again.
fn changed(folder: &Path, name: &str, change: impl FnOnce(&mut Flight)) -> PathBuf {
    let mut flight = import::open(&SOUND[0], None).expect("a log");
    change(&mut flight);
    let path = folder.join(name);
    import::write(&flight, &path).expect("a log");
    path
}

/// A flight whose gyro freezes for two seconds.
fn frozen(flight: &mut Flight) {
    let mut stood = Stream::default();
    let mut held = None;
    for (time, rate) in flight.body_rate.iter() {
        let from = *held.get_or_insert((time + 8.0, *rate));
        let still = (from.0..from.0 + 2.0).contains(&time);
        if !still && time < from.0 {
            held = Some((from.0, *rate));
        }
        stood.push(time, if still { from.1 } else { *rate });
    }
    flight.body_rate = stood;
}

/// A narrow window finds too few samples where they are sparse.
#[test]
fn earlier_window_is_used_if_a_later_one_lacks_rows() {
    let folder = learn::folder("seldom");
    let mut flight = import::open(&SOUND[3], None).expect("a log");
    let mut thinned = Stream::default();
    for (index, (time, rate)) in flight.body_rate.iter().enumerate() {
        // Every third sample, every other second.
        if time.rem_euclid(2.0) < 1.0 || index % 3 == 0 {
            thinned.push(time, *rate);
        }
    }
    flight.body_rate = thinned;
    let log = folder.join("seldom.mcap");
    import::write(&flight, &log).expect("a log");
    let trained = |windows: &str| {
        let model = folder.join("model.safetensors");
        let _ = fs::remove_file(&model);
        // A network no better than holding the state.
        let poor = ["--passes", "1", "--hidden", "1", "--regularization", "1e-5", "--json"];
        let output = learn::downwash(&folder)
            .args(["train", "--window", windows, "--vehicle"])
            .args([&learn::vehicle(), &log])
            .arg("--out")
            .arg(&model)
            .args(poor)
            .output()
            .expect("the command runs");
        (model.exists(), output)
    };
    let (is_there, output) = trained("1");
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!is_there && stderr.contains("rows to train on"), "{stderr}");
    let (is_there, output) = trained("22,1");
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(is_there && stderr.contains("using the earlier window's models"), "{stderr}");
    let taken = learn::number(&learn::summary(&output), "/settings/window_half_s");
    assert_eq!(taken, 0.022);
}

#[test]
fn log_with_mismatched_thrust_is_from_another_vehicle() {
    let folder = learn::folder("heavy");
    let text = fs::read_to_string(learn::vehicle()).expect("a vehicle");
    let heavy = text.replace("mass = 0.030", "mass = 0.090");
    let heavy = file(&folder, "heavy.toml", heavy.as_bytes());
    let log = tlog(&folder, "flight.tlog", |_| ());
    let output = learn::downwash(&folder)
        .args(["train", "--out", "model.safetensors", "--vehicle"])
        .args([&heavy, &log])
        .current_dir(&folder)
        .output()
        .expect("the command runs");
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{stderr}");
    assert!(stderr.contains("from another vehicle") && stderr.contains("0.3"), "{stderr}");
    assert!(!folder.join("model.safetensors").exists());
}

#[test]
fn log_with_a_different_vehicle_file_is_refused() {
    let folder = learn::folder("foreign");
    let text = fs::read_to_string(learn::vehicle()).expect("a vehicle");
    let other = text.replace("inertia = [1.66e-5", "inertia = [1.99e-5");
    assert_ne!(text, other);
    let other = file(&folder, "other.toml", other.as_bytes());
    let output = learn::downwash(&folder)
        .args(["train", "--out", "model.safetensors", "--vehicle"])
        .args([&other, &SOUND[0]])
        .current_dir(&folder)
        .output()
        .expect("the command runs");
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{stderr}");
    assert!(stderr.contains("from another vehicle: inertia"), "{stderr}");
}

#[test]
fn too_little_flight_gives_no_model() {
    let folder = learn::folder("little");
    let log = tlog(&folder, "little.tlog", |entries| {
        let start = entries[0].0;
        entries.retain(|(time, _)| (10_000_000..15_000_000).contains(&(time - start)));
    });
    let (output, model) = learn::train("little-model", &[log], &[]);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{stderr}");
    assert!(stderr.contains("rows to train on") || stderr.contains("is usable"), "{stderr}");
    assert!(!model.exists());
}

#[test]
fn mismatched_motor_order_is_refused_with_both_orders() {
    let folder = learn::folder("order");
    let mut flight = import::open(&SOUND[0], None).expect("a log");
    let rotor = |front, right, spin| RotorFact { front, right, spin };
    // PX4's order of an X; the shipped file is clockwise from front right.
    flight.facts.rotors =
        vec![rotor(1.0, 1.0, 1), rotor(-1.0, -1.0, 1), rotor(1.0, -1.0, -1), rotor(-1.0, 1.0, -1)];
    let log = folder.join("px4.mcap");
    import::write(&flight, &log).expect("a log");
    let output = learn::downwash(&folder)
        .args(["train", "--out", "model.safetensors", "--vehicle"])
        .args([&learn::vehicle(), &log])
        .current_dir(&folder)
        .output()
        .expect("the command runs");
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{stderr}");
    let orders = [
        "front right (spin +1), rear left (spin +1), front left (spin -1), rear right (spin -1)",
        "front right (spin +1), rear right (spin -1), rear left (spin +1), front left (spin -1)",
    ];
    assert!(orders.iter().all(|order| stderr.contains(order)), "{stderr}");
}
