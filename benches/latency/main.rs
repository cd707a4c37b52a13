//! Telemetry datagram in, setpoint datagram out, over loopback UDP in real time, measured from
//! outside: a minimal vehicle stamps its ODOMETRY when it sends it and the daemon's setpoint when
//! it receives it. Half a period later, at the same rate, it sends the same datagram to a plain C
//! echo, which is the lower bound on this machine.
//!
//! All processes run on one core, where waking another adds no noise.

mod processes;
mod vehicle;
mod viewer;

use std::path::PathBuf;
use std::time::{Duration, Instant};

use self::processes::{Process, pin};
use self::vehicle::{Vehicle, receive, socket_to};
use self::viewer::Manner;

const HELP: &str = "\
Latency of the control line beside a C echo, over loopback UDP.

cargo bench --bench latency -- [OPTIONS]
    --rate HZ       telemetry and control rate [100]
    --seconds S     length of the measurement [60]
    --pin CORE      the core for all processes [the last]
    --no-pin        leave them to the scheduler
    --view          serve the live view, to one client on any core that takes all topics
    --view-stalls   the same, to one that asks for all topics and never reads
    --view-sets     the same, to one that sets the feedback's factor twenty times a second
    --daemon PATH   the downwash to measure [the one that was just built]
    --json          one line of JSON";

/// Time limit for the daemon to identify the vehicle and start streaming.
const START_LIMIT: Duration = Duration::from_secs(20);
/// Requirements on the control path: over the echo's median, us; times the echo's 99th percentile;
/// fraction of a core.
const P50_OVER_ECHO_US: f64 = 30.0;
const P99_OF_ECHO: f64 = 3.0;
const CPU_SHARE: f64 = 0.05;

struct Options {
    seconds: f64,
    rate_hz: f64,
    pin: Option<usize>,
    daemon: PathBuf,
    viewer: Option<Manner>,
    json: bool,
}

fn options() -> Options {
    let last = std::thread::available_parallelism().map_or(0, |cores| cores.get() - 1);
    let mut options = Options {
        seconds: 60.0,
        rate_hz: 100.0,
        pin: Some(last),
        daemon: env!("CARGO_BIN_EXE_downwash").into(),
        viewer: None,
        json: false,
    };
    let mut args = std::env::args().skip(1);
    let stop = |why: &str| -> ! {
        eprintln!("{why}\n\n{HELP}");
        std::process::exit(2);
    };
    while let Some(arg) = args.next() {
        let mut number = || -> f64 {
            let text = args.next().unwrap_or_default();
            let number = text.parse().ok().filter(|number: &f64| *number >= 0.0);
            number.unwrap_or_else(|| stop(&format!("{arg}: expected a number, found {text:?}")))
        };
        match arg.as_str() {
            "--seconds" => options.seconds = number(),
            "--rate" => options.rate_hz = number().max(1.0),
            "--pin" => options.pin = Some(number() as usize),
            "--no-pin" => options.pin = None,
            "--daemon" => options.daemon = args.next().unwrap_or_default().into(),
            "--view" => options.viewer = Some(Manner::Takes),
            "--view-stalls" => options.viewer = Some(Manner::Stalls),
            "--view-sets" => options.viewer = Some(Manner::Sets),
            "--json" => options.json = true,
            "--bench" => {} // cargo adds it
            "--help" | "-h" => {
                println!("{HELP}");
                std::process::exit(0);
            }
            other => stop(&format!("unknown flag {other}")),
        }
    }
    options
}

/// Times in us, sorted.
struct Latencies(Vec<f64>);

impl Latencies {
    fn new(mut us: Vec<f64>) -> Self {
        us.sort_by(f64::total_cmp);
        Self(us)
    }

    /// The quantile `share`, by nearest rank.
    fn quantile(&self, share: f64) -> f64 {
        let rank = (self.0.len() as f64 * share).ceil() as usize;
        self.0.get(rank.saturating_sub(1)).copied().unwrap_or(f64::NAN)
    }

    fn json(&self) -> serde_json::Value {
        serde_json::json!({
            "answers": self.0.len(), "p50_us": self.quantile(0.5), "p99_us": self.quantile(0.99),
            "p999_us": self.quantile(0.999), "max_us": self.quantile(1.0),
        })
    }

    fn row(&self) -> String {
        let columns = [0.5, 0.99, 0.999, 1.0].map(|share| format!("{:9.1}", self.quantile(share)));
        columns.join(" ")
    }
}

/// Results of a run.
struct Measured {
    daemon: Latencies,
    echo: Latencies,
    ticks: usize,
    /// Setpoints that arrived more than half a period after their telemetry.
    late: usize,
    /// Ticks whose setpoint never arrived.
    missed: usize,
    /// Ticks that this process itself started too late to keep the pace.
    slipped: usize,
    cpu_share: f64,
}

/// Paces the sends evenly.
struct Pace {
    next: Instant,
    step: Duration,
    slipped: usize,
}

impl Pace {
    fn new(step: Duration) -> Self {
        Self { next: Instant::now(), step, slipped: 0 }
    }

    /// Sleeps until the next step. A busy machine may wake this process late: missed steps are not
    /// made up by a burst, which no vehicle would send.
    fn wait(&mut self) {
        self.next += self.step;
        std::thread::sleep(self.next.saturating_duration_since(Instant::now()));
        let now = Instant::now();
        if now > self.next + self.step / 2 {
            self.next = now;
            self.slipped += 1;
        }
    }
}

fn measure(options: &Options, vehicle: &mut Vehicle, daemon: &Process, echo_port: u16) -> Measured {
    let ticks = (options.seconds * options.rate_hz).round() as usize;
    let (mut ours, mut floor) = (Vec::with_capacity(ticks), Vec::with_capacity(ticks));
    let (mut late, mut unanswered) = (0, 0);
    let echo = socket_to(echo_port);
    let mut echoed = [0; 2048];
    let half = Duration::from_secs_f64(0.5 / options.rate_hz);
    let us = |from: Instant, to: Instant| (to - from).as_secs_f64() * 1e6;
    vehicle.late_setpoints();
    let (cpu_start, begun) = (daemon.cpu_seconds(), Instant::now());
    let mut pace = Pace::new(half);
    for tick in 0..ticks {
        if tick % options.rate_hz as usize == 0 {
            vehicle.send_slow_messages();
        }
        pace.wait();
        late += vehicle.late_setpoints();
        let sent = vehicle.send_odometry();
        match vehicle.await_setpoint(sent + half) {
            Some(heard) => ours.push(us(sent, heard)),
            None => unanswered += 1,
        }
        pace.wait();
        while receive(&echo, &mut echoed, Instant::now()).is_some() {}
        let sent = Instant::now();
        let _ = echo.send(vehicle.last_frame());
        if let Some((_, heard)) = receive(&echo, &mut echoed, sent + half) {
            floor.push(us(sent, heard));
        }
    }
    let cpu_share = (daemon.cpu_seconds() - cpu_start) / begun.elapsed().as_secs_f64();
    std::thread::sleep(half);
    late += vehicle.late_setpoints();
    Measured {
        daemon: Latencies::new(ours),
        echo: Latencies::new(floor),
        ticks,
        late,
        missed: unanswered - late.min(unanswered),
        slipped: pace.slipped,
        cpu_share,
    }
}

/// Load averages over 1, 5 and 15 minutes, to show other load on the machine.
fn load() -> String {
    let text = std::fs::read_to_string("/proc/loadavg").unwrap_or_default();
    text.split_whitespace().take(3).collect::<Vec<_>>().join(" ")
}

fn report(options: &Options, measured: &Measured, load_before: &str) {
    let Measured { daemon, echo, ticks, late, missed, slipped, cpu_share } = measured;
    let p50_over_us = daemon.quantile(0.5) - echo.quantile(0.5);
    let p99_ratio = daemon.quantile(0.99) / echo.quantile(0.99);
    let load_after = load();
    if options.json {
        let report = serde_json::json!({
            "schema": "downwash.bench.latency", "schema_version": 2,
            "rate_hz": options.rate_hz, "core": options.pin, "load_before": load_before,
            "load_after": load_after, "ticks": ticks, "late": late, "missed": missed,
            "slipped": slipped, "cpu_share": cpu_share, "p50_over_echo_us": p50_over_us,
            "p99_of_echo": p99_ratio, "daemon": daemon.json(), "echo": echo.json(),
        });
        println!("{report}");
        return;
    }
    let place =
        options.pin.map_or("no core of their own".to_owned(), |core| format!("core {core}"));
    println!(
        "{} Hz for {} s on {place}; load {load_before} -> {load_after}",
        options.rate_hz, options.seconds
    );
    println!("{:10} {:>9} {:>9} {:>9} {:>9}", "us", "p50", "p99", "p99.9", "max");
    println!("{:10} {}", "daemon", daemon.row());
    println!("{:10} {}", "C echo", echo.row());
    println!("p50 {p50_over_us:+.1} us over the echo's (at most {P50_OVER_ECHO_US})");
    println!("p99 {p99_ratio:.2} times the echo's (at most {P99_OF_ECHO})");
    println!(
        "{missed} of {ticks} ticks missed, {late} late by half a period, {slipped} begun late here"
    );
    println!("{:.2} % of one core (at most {})", 100.0 * cpu_share, 100.0 * CPU_SHARE);
}

fn main() {
    let options = options();
    if let Some(core) = options.pin {
        pin(core);
    }
    let load_before = load();
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("latency");
    std::fs::create_dir_all(&folder).expect("a folder");
    let echo = Process::echo(&folder);
    let daemon = Process::daemon(&options.daemon, &folder, options.rate_hz, options.viewer);
    let mut vehicle = Vehicle::new(daemon.port);
    let period = Duration::from_secs_f64(1.0 / options.rate_hz);
    if !vehicle.is_streamed_to(period, START_LIMIT) {
        let words = daemon.log.as_ref().and_then(|log| std::fs::read_to_string(log).ok());
        eprintln!(
            "the daemon did not stream {} setpoints a second within {} s; it said:\n{}",
            options.rate_hz,
            START_LIMIT.as_secs(),
            words.unwrap_or_default()
        );
        std::process::exit(1);
    }
    let viewer = options.viewer.map(|manner| viewer::watch(&daemon, manner));
    let measured = measure(&options, &mut vehicle, &daemon, echo.port);
    report(&options, &measured, &load_before);
    if let Some(viewer) = viewer {
        eprintln!("the viewer was given {} messages", viewer.messages());
    }
}
