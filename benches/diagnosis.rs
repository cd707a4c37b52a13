//! `downwash diagnose` on ten minutes of flight against the whole catalogue: run time of the whole
//! process, from logs to the answer, and its peak memory.
//!
//! `cargo bench --bench diagnosis -- [--minutes 10] [--twins 40] [--seed 1]`
//!
//! The flights are an exam's: a vehicle with one effect, drawn from the seed, telemetry at up to
//! 250 Hz, one flight per minute, with the last held out.

use std::fs;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use downwash::exam::case::Case;
use downwash::exam::order::{Kind, Order, Settings};

/// Interval of the peak memory samples.
const POLL: Duration = Duration::from_millis(50);
/// Strength of the effect.
const RATIO: f64 = 6.0;

struct Options {
    minutes: usize,
    twins: u32,
    seed: u64,
}

fn options() -> Options {
    let mut options = Options { minutes: 10, twins: 40, seed: 1 };
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        let mut value = || args.next().unwrap_or_else(|| panic!("{arg}: expected a value"));
        match arg.as_str() {
            "--minutes" => options.minutes = value().parse().expect("a number of minutes"),
            "--twins" => options.twins = value().parse().expect("a number of twins"),
            "--seed" => options.seed = value().parse().expect("a seed"),
            "--bench" => {} // cargo adds it
            other => panic!("unknown flag {other}"),
        }
    }
    options
}

/// The peak memory of a process so far, MB, as Linux reports it.
fn peak_mb(child: &Child) -> Option<f64> {
    let status = fs::read_to_string(format!("/proc/{}/status", child.id())).ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kilobytes: f64 = line.split_whitespace().next()?.parse().ok()?;
    Some(kilobytes / 1024.0)
}

fn main() {
    let Options { minutes, twins, seed } = options();
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("diagnosis-bench");
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).expect("a folder");
    let settings =
        Settings { flights: minutes, seconds: 60.0, ratios: [RATIO; 2], ..Settings::default() };
    let case = Case::fly(&settings, seed, 0, "bench", &Order::from(Kind::Single)).expect("flights");
    let vehicle = serde_json::to_vec(&case.nominal).expect("a vehicle file");
    fs::write(folder.join("vehicle.json"), vehicle).expect("a vehicle file");
    let mut command = Command::new(env!("CARGO_BIN_EXE_downwash"));
    command.current_dir(&folder).args(["diagnose", "--json", "--vehicle", "vehicle.json"]);
    command.args(["--twins", &twins.to_string()]);
    for (number, log) in case.logs.iter().enumerate() {
        let name = format!("flight_{}.tlog", number + 1);
        fs::write(folder.join(&name), log).expect("a log");
        command.arg(name);
    }
    let answer = fs::File::create(folder.join("answer.json")).expect("a file");
    let began = Instant::now();
    let mut child =
        command.stdout(answer).stderr(Stdio::null()).spawn().expect("the program starts");
    let mut peak: f64 = 0.0;
    let status = loop {
        peak = peak_mb(&child).map_or(peak, |now| now.max(peak));
        match child.try_wait().expect("its status") {
            Some(status) => break status,
            None => std::thread::sleep(POLL),
        }
    };
    let seconds = began.elapsed().as_secs_f64();
    assert!(status.success(), "the diagnosis ended with {status}");
    let answer = fs::read(folder.join("answer.json")).expect("the answer");
    let answer: serde_json::Value = serde_json::from_slice(&answer).expect("an answer");
    let truth: Vec<&str> = case.key.effects.iter().map(|effect| effect.id.as_str()).collect();
    println!("{minutes} min of flight, {twins} twins: {seconds:.1} s, {peak:.0} MB at most");
    println!("true {}, said {} {}", truth.join(" "), answer["verdict"], answer["effects"][0]["id"]);
}
