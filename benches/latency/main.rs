//! Telemetry datagram in, setpoint datagram out, over loopback UDP in real time, measured from
//! outside: a minimal vehicle stamps its ODOMETRY when it sends it and the daemon's setpoint when
//! it has it. Beside it, paced alike in the same run, the same datagrams go to a plain C echo,
//! which is the floor that the machine sets.
//!
//! `cargo bench --bench latency -- [--seconds 60] [--rate 100] [--pin CORE] [--json]`

use std::io::{BufRead, BufReader};
use std::net::UdpSocket;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use wire::dialect::*;
use wire::{Decoder, Encoder};

/// Wait for an answer before it counts as missed.
const TIMEOUT: Duration = Duration::from_millis(100);

struct Options {
    seconds: f64,
    rate_hz: f64,
    pin: Option<usize>,
    json: bool,
}

fn options() -> Options {
    let mut options = Options { seconds: 60.0, rate_hz: 100.0, pin: None, json: false };
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        let mut number = || {
            let text = args.next().unwrap_or_default();
            text.parse::<f64>()
                .unwrap_or_else(|_| panic!("{arg}: expected a number, found {text:?}"))
        };
        match arg.as_str() {
            "--seconds" => options.seconds = number(),
            "--rate" => options.rate_hz = number(),
            "--pin" => options.pin = Some(number() as usize),
            "--json" => options.json = true,
            "--bench" => {} // cargo adds it
            other => panic!("unknown flag {other}"),
        }
    }
    options
}

/// Kills its process when dropped.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn start_echo(folder: &Path) -> (Running, u16) {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("benches/latency/echo.c");
    let binary = folder.join("echo");
    let built = Command::new("cc").arg("-O2").arg(&source).arg("-o").arg(&binary).status();
    assert!(built.is_ok_and(|status| status.success()), "cc cannot build {}", source.display());
    let mut child = Command::new(binary).stdout(Stdio::piped()).spawn().expect("the echo starts");
    let mut line = String::new();
    let out = child.stdout.take().expect("its output");
    BufReader::new(out).read_line(&mut line).expect("its port");
    (Running(child), line.trim().parse().expect("a port"))
}

fn start_daemon(folder: &Path, port: u16, rate_hz: f64) -> Running {
    let config = folder.join("config.toml");
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let text = format!(
        "vehicle = {:?}\ntrajectory = {:?}\nconnect = \"udpin:127.0.0.1:{port}\"\nlog_dir = {:?}\n\
         [control]\nrate_hz = {rate_hz}\n",
        root.join("config/vehicles/crazyflie.toml"),
        root.join("config/trajectories/hover.toml"),
        folder,
    );
    std::fs::write(&config, text).expect("the configuration is written");
    let child = Command::new(env!("CARGO_BIN_EXE_downwash"))
        .args(["daemon", "--config"])
        .arg(config)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .expect("the daemon starts");
    Running(child)
}

/// User and system time of a process so far, s.
fn cpu_seconds(child: &Child) -> f64 {
    let stat = std::fs::read_to_string(format!("/proc/{}/stat", child.id())).unwrap_or_default();
    let after_name = stat.rsplit(')').next().unwrap_or_default();
    let ticks = |index: usize| -> f64 {
        after_name.split_whitespace().nth(index).and_then(|t| t.parse().ok()).unwrap_or(0.0)
    };
    (ticks(11) + ticks(12)) / 100.0
}

/// The least of a vehicle that the daemon streams its hold to: it stands on the ground, disarmed,
/// in HOLD, and answers what it is asked.
struct Vehicle {
    socket: UdpSocket,
    encoder: Encoder,
    decoder: Decoder,
    start: Instant,
    buffer: Vec<u8>,
}

impl Vehicle {
    fn new(daemon_port: u16) -> Self {
        let socket = UdpSocket::bind("127.0.0.1:0").expect("a socket");
        socket.connect(("127.0.0.1", daemon_port)).expect("connected");
        Self {
            socket,
            encoder: Encoder::new(1, 1),
            decoder: Decoder::new(),
            start: Instant::now(),
            buffer: Vec::with_capacity(512),
        }
    }

    fn send(&mut self, message: &MavMessage) -> Instant {
        self.buffer.clear();
        self.encoder.encode(message, &mut self.buffer);
        let stamp = Instant::now();
        // Refused until the daemon listens.
        let _ = self.socket.send(&self.buffer);
        stamp
    }

    fn time_us(&self) -> u64 {
        self.start.elapsed().as_micros() as u64 + 1_000_000
    }

    fn send_slow_messages(&mut self) {
        self.send(&MavMessage::HEARTBEAT(HEARTBEAT_DATA {
            custom_mode: 4 << 16 | 3 << 24,
            mavtype: MavType::MAV_TYPE_QUADROTOR,
            autopilot: MavAutopilot::MAV_AUTOPILOT_PX4,
            base_mode: MavModeFlag::MAV_MODE_FLAG_CUSTOM_MODE_ENABLED,
            system_status: MavState::MAV_STATE_STANDBY,
            mavlink_version: 3,
        }));
        let hold = 4 << 16 | 3 << 24;
        self.send(&MavMessage::CURRENT_MODE(CURRENT_MODE_DATA {
            custom_mode: hold,
            intended_custom_mode: hold,
            ..Default::default()
        }));
        self.send(&MavMessage::EXTENDED_SYS_STATE(EXTENDED_SYS_STATE_DATA {
            landed_state: MavLandedState::MAV_LANDED_STATE_ON_GROUND,
            ..Default::default()
        }));
    }

    fn send_odometry(&mut self) -> Instant {
        let message = MavMessage::ODOMETRY(ODOMETRY_DATA {
            time_usec: self.time_us(),
            frame_id: MavFrame::MAV_FRAME_LOCAL_NED,
            child_frame_id: MavFrame::MAV_FRAME_LOCAL_NED,
            q: [1.0, 0.0, 0.0, 0.0],
            ..Default::default()
        });
        self.send(&message)
    }

    /// Setpoints that came after their time.
    fn late_setpoints(&mut self) -> usize {
        let mut late = 0;
        while self.await_setpoint(Instant::now() + Duration::from_micros(1)).is_some() {
            late += 1;
        }
        late
    }

    /// Reads until a setpoint arrives, and answers everything else.
    fn await_setpoint(&mut self, until: Instant) -> Option<Instant> {
        let mut datagram = [0; 2048];
        loop {
            let left = until.checked_duration_since(Instant::now()).filter(|d| !d.is_zero())?;
            self.socket.set_read_timeout(Some(left)).expect("a time-out");
            let Ok(count) = self.socket.recv(&mut datagram) else { continue };
            let stamp = Instant::now();
            self.decoder.push(&datagram[..count]);
            let mut setpoint = false;
            while let Some(frame) = self.decoder.next_frame() {
                match frame.message() {
                    Ok(MavMessage::SET_ATTITUDE_TARGET(_)) => setpoint = true,
                    Ok(message) => self.answer(&message),
                    Err(_) => {}
                }
            }
            if setpoint {
                return Some(stamp);
            }
        }
    }

    fn answer(&mut self, message: &MavMessage) {
        match message {
            MavMessage::TIMESYNC(sync) if sync.tc1 == 0 => {
                let tc1 = self.time_us() as i64 * 1000;
                let reply = TIMESYNC_DATA { tc1, ts1: sync.ts1, ..Default::default() };
                self.send(&MavMessage::TIMESYNC(reply));
            }
            MavMessage::COMMAND_LONG(command) => {
                if command.command == MavCmd::MAV_CMD_REQUEST_MESSAGE && command.param1 == 148.0 {
                    let version = AUTOPILOT_VERSION_DATA {
                        vendor_id: 0x4457,
                        product_id: 1,
                        ..Default::default()
                    };
                    self.send(&MavMessage::AUTOPILOT_VERSION(version));
                }
                let ack = COMMAND_ACK_DATA { command: command.command, ..Default::default() };
                self.send(&MavMessage::COMMAND_ACK(ack));
            }
            _ => {}
        }
    }
}

/// Sleeps, and spins the last stretch, as a vehicle's timer interrupt would fire on time.
fn wait_until(at: Instant) {
    if let Some(left) = at.checked_duration_since(Instant::now()) {
        std::thread::sleep(left);
    }
}

struct Quantiles {
    p50: f64,
    p99: f64,
    p999: f64,
    max: f64,
}

fn quantiles(latencies: &mut [f64]) -> Quantiles {
    latencies.sort_by(f64::total_cmp);
    let at = |share: f64| {
        let index = (latencies.len() as f64 * share) as usize;
        latencies.get(index.min(latencies.len().saturating_sub(1))).copied().unwrap_or(f64::NAN)
    };
    Quantiles { p50: at(0.5), p99: at(0.99), p999: at(0.999), max: at(1.0) }
}

fn main() {
    let options = options();
    if let Some(core) = options.pin {
        // SAFETY: plain values; the set is initialised before it is read.
        let pinned = unsafe {
            let mut set: libc::cpu_set_t = std::mem::zeroed();
            libc::CPU_SET(core, &mut set);
            libc::sched_setaffinity(0, size_of_val(&set), &set)
        };
        assert_eq!(pinned, 0, "cannot pin to core {core}");
    }
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("latency");
    std::fs::create_dir_all(&folder).expect("a folder");
    let (_echo, echo_port) = start_echo(&folder);
    let echo = UdpSocket::bind("127.0.0.1:0").expect("a socket");
    echo.connect(("127.0.0.1", echo_port)).expect("connected");
    echo.set_read_timeout(Some(TIMEOUT)).expect("a time-out");
    let port = {
        let probe = UdpSocket::bind("127.0.0.1:0").expect("a socket");
        probe.local_addr().expect("its address").port()
    };
    let daemon = start_daemon(&folder, port, options.rate_hz);
    let mut vehicle = Vehicle::new(port);

    let period = Duration::from_secs_f64(1.0 / options.rate_hz);
    let warm_up = (5.0 * options.rate_hz) as usize;
    let counted = (options.seconds * options.rate_hz) as usize;
    let (mut ours, mut floor) = (Vec::with_capacity(counted), Vec::with_capacity(counted));
    let (mut late, mut unanswered, mut cpu_start, mut begun) = (0, 0, 0.0, Instant::now());
    let mut next = Instant::now();
    let mut echoed = [0; 2048];
    for tick in 0..warm_up + counted {
        if tick % options.rate_hz as usize == 0 {
            vehicle.send_slow_messages();
        }
        if tick == warm_up {
            (cpu_start, begun) = (cpu_seconds(&daemon.0), Instant::now());
            (late, unanswered) = (0, 0);
            (ours, floor) = (Vec::with_capacity(counted), Vec::with_capacity(counted));
        }
        next += period / 2;
        wait_until(next);
        late += vehicle.late_setpoints();
        let sent = vehicle.send_odometry();
        match vehicle.await_setpoint(sent + period / 2) {
            Some(heard) => ours.push((heard - sent).as_secs_f64() * 1e6),
            None => unanswered += 1,
        }
        next += period / 2;
        wait_until(next);
        let sent = Instant::now();
        let _ = echo.send(&vehicle.buffer);
        if echo.recv(&mut echoed).is_ok() {
            floor.push(sent.elapsed().as_secs_f64() * 1e6);
        }
    }
    late += vehicle.late_setpoints();
    // What came after half a period is late; what never came is missed.
    let missed = unanswered - late.min(unanswered);
    let cpu_share = (cpu_seconds(&daemon.0) - cpu_start) / begun.elapsed().as_secs_f64();
    let (daemon_us, echo_us) = (quantiles(&mut ours), quantiles(&mut floor));
    if options.json {
        let row = |q: &Quantiles| serde_json::json!({"p50_us": q.p50, "p99_us": q.p99, "p999_us": q.p999, "max_us": q.max});
        let report = serde_json::json!({
            "schema": "downwash.bench.latency", "schema_version": 1,
            "rate_hz": options.rate_hz, "ticks": counted, "late": late, "missed": missed, "cpu_share": cpu_share,
            "daemon": row(&daemon_us), "echo": row(&echo_us),
        });
        println!("{report}");
    } else {
        println!(
            "{} ticks at {} Hz, {missed} missed, {late} late, {:.1} % of one core",
            counted,
            options.rate_hz,
            100.0 * cpu_share
        );
        println!("{:10} {:>9} {:>9} {:>9} {:>9}", "us", "p50", "p99", "p99.9", "max");
        for (name, q) in [("daemon", &daemon_us), ("C echo", &echo_us)] {
            println!("{name:10} {:9.1} {:9.1} {:9.1} {:9.1}", q.p50, q.p99, q.p999, q.max);
        }
    }
}
