//! A synthetic flight with the streams, rates and sizes of a real one: take-off, a sinusoid in x
//! and y with turning yaw, landing. The vehicle follows the reference with a lag and some noise.

use std::time::{Duration, Instant};

use downwash::clock::{HostTime, VehicleTime};
use downwash::log::record::{
    Direction, FrameRecord, LinkStats, Record, Severity, Source, Stamp, Tick, TimesyncSample, Truth,
};
use downwash::log::{LogWriter, RunInfo};
use downwash::setpoint::{Reference, Setpoint, State};
use vehicle::frame::{Euler, Frd, Ned};

pub const START: HostTime = HostTime::from_ns(1_767_225_600_000_000_000);
const HOVER_N: f64 = 0.33;

/// Pseudo-random numbers in [-1, 1] (xorshift64).
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }

    fn frd(&mut self, scale: f64) -> Frd {
        Frd::new(self.next() * scale, self.next() * scale, self.next() * scale)
    }

    fn ned(&mut self, scale: f64) -> Ned {
        Ned::new(self.next() * scale, self.next() * scale, self.next() * scale)
    }
}

/// Phase, trajectory time and reference at `t` seconds of a flight of `duration` seconds.
fn plan(t: f64, duration: f64) -> (&'static str, Option<f64>, Reference) {
    let (climb, descent) = (0.15 * duration, 0.85 * duration);
    let height = 1.0 * (t / climb).min(1.0) * ((duration - t) / (duration - descent)).min(1.0);
    let mut reference = Reference {
        position: Ned::new(0.0, 0.0, -height),
        feedforward: Setpoint { thrust_n: HOVER_N, ..Setpoint::default() },
        ..Reference::default()
    };
    if t < climb {
        return ("takeoff", None, reference);
    }
    if t >= descent {
        return ("land", None, reference);
    }
    let s = t - climb;
    let (w, a, yaw_rate) = (1.2, 0.8, 0.4);
    reference.position = Ned::new(a * (w * s).sin(), a * (0.5 * w * s).sin(), -height);
    reference.velocity = Ned::new(a * w * (w * s).cos(), 0.5 * a * w * (0.5 * w * s).cos(), 0.0);
    reference.attitude = Euler::new(0.0, 0.0, vehicle::frame::wrap_angle(yaw_rate * s));
    reference.body_rate = Frd::new(0.0, 0.0, yaw_rate);
    reference.feedforward.attitude = reference.attitude;
    ("track", Some(s), reference)
}

fn frame(
    direction: Direction,
    host: HostTime,
    id: u8,
    payload: usize,
    noise: &mut Noise,
) -> Record {
    let mut bytes = vec![0xFD, payload as u8, 0, 0, 0, 1, 1, id, 0, 0];
    // Like slowly changing floats: the high half stays the same.
    let body =
        (0..payload + 2).map(|i| if i % 4 < 2 { (noise.next() * 127.0) as u8 } else { 0x3E });
    bytes.extend(body);
    Record::Frame(FrameRecord::from_bytes(direction, host, &bytes).expect("a whole frame"))
}

/// Every record of a flight of `duration` seconds, in order of time.
pub fn records(duration: f64) -> Vec<Record> {
    let mut noise = Noise(0x9E37_79B9_7F4A_7C15);
    let mut out = Vec::new();
    let mut error = Ned::zero();
    let event = |host, severity, source, text: &str| Record::Event {
        host,
        severity,
        source,
        text: text.into(),
    };
    out.push(event(START, Severity::Info, Source::Daemon, "armed"));
    for ms in (0..(duration * 1000.0) as u64).step_by(2) {
        let host = START + Duration::from_millis(ms);
        let vehicle = VehicleTime::from_ms(ms as u32 + 5000);
        let stamp = Stamp::new(host, vehicle, host - Duration::from_micros(1500));
        let t = ms as f64 * 1e-3;
        let (phase, trajectory_time, reference) = plan(t, duration);
        if ms % 4 == 0 {
            out.push(frame(Direction::Rx, host, 31, 32, &mut noise));
            out.push(frame(Direction::Rx, host, 105, 62, &mut noise));
            out.push(Record::Imu {
                stamp,
                specific_force: Frd::new(0.0, 0.0, -9.81) + noise.frd(0.1),
                body_rate: noise.frd(0.02),
            });
        }
        if ms % 10 != 0 {
            continue;
        }
        for (id, payload) in [(32, 28), (140, 140), (331, 230)] {
            out.push(frame(Direction::Rx, host, id as u8, payload, &mut noise));
        }
        let lag = reference.velocity * -0.06;
        error = error * 0.97 + (lag + noise.ned(0.02)) * 0.03;
        let attitude = Euler::new(
            0.1 * (1.2 * t).sin() + 0.002 * noise.next(),
            -0.1 * (1.2 * t).cos() + 0.002 * noise.next(),
            reference.attitude.yaw + 0.01 * noise.next(),
        );
        let state = State {
            position: reference.position + error + noise.ned(0.001),
            velocity: reference.velocity + error * -2.0 + noise.ned(0.01),
            attitude: attitude.attitude(),
            body_rate: reference.body_rate + noise.frd(0.02),
        };
        let feedback = Setpoint {
            thrust_n: error.down() * 2.0,
            attitude: Euler::new(error.east() * -0.8, error.north() * 0.8, 0.0),
            body_rate: noise.frd(0.05),
        };
        let ff = reference.feedforward;
        let setpoint = Setpoint {
            thrust_n: ff.thrust_n + feedback.thrust_n,
            attitude: Euler::new(
                ff.attitude.roll + feedback.attitude.roll,
                ff.attitude.pitch + feedback.attitude.pitch,
                ff.attitude.yaw,
            ),
            body_rate: ff.body_rate + feedback.body_rate,
        };
        out.push(Record::Motors { stamp, outputs: [0.52, 0.51, 0.53, 0.5] });
        out.push(Record::Truth { stamp, truth: Truth { state, ..Truth::default() } });
        out.push(Record::Tick(Tick {
            stamp,
            state,
            reference: Some(reference),
            desired: None,
            tube_radius_m: None,
            feedback,
            setpoint: (phase != "land" || t < duration - 0.5).then_some(setpoint),
            saturation: u32::from(ms % 5000 == 0) << 1,
            phase,
            trajectory_time,
            sample_age: 0.0015 + 0.0004 * noise.next().abs(),
        }));
        out.push(frame(Direction::Tx, host, 82, 39, &mut noise));
        if ms % 200 == 0 {
            out.push(Record::Battery {
                stamp: Stamp::host(host),
                voltage: Some(4.1 - 0.004 * t),
                current: (ms > 1000).then_some(6.0),
                remaining: None,
            });
        }
        if ms % 1000 == 0 {
            let stats = LinkStats {
                rx_frames_hz: 800.0,
                rx_bytes_per_s: 71_000.0,
                tx_frames_hz: 102.0,
                tx_bytes_per_s: 5200.0,
                attitude_hz: 250.0,
                position_hz: 100.0,
                odometry_hz: 100.0,
                rtt_s: 0.0011 + 0.0003 * noise.next(),
                clock_offset_s: 5.0,
                ..LinkStats::default()
            };
            out.push(Record::Link { host, stats });
            let sample = TimesyncSample {
                rtt_s: stats.rtt_s,
                measured_offset_s: 5.0 + 1e-5 * noise.next(),
                offset_s: 5.0,
                accepted: true,
            };
            out.push(Record::Timesync { host, sample });
        }
        if ms == 4000 {
            out.push(event(host, Severity::Warning, Source::Vehicle, "Low battery, \"10 %\""));
        }
    }
    let end = START + Duration::from_secs_f64(duration);
    out.push(event(end, Severity::Info, Source::Daemon, "disarmed"));
    out
}

pub fn run_info() -> RunInfo {
    RunInfo {
        vehicle: "crazyflie 2".into(),
        run: "sinusoid-yaw".into(),
        tool_version: "0.1.0".into(),
        simulated: true,
        seed: Some(7),
        dialect: "ardupilotmega".into(),
        config: "schema_version = 1\n".into(),
        vehicle_file: Some(("vehicle.toml".into(), "mass_kg = 0.034\n".into())),
        rotors: [(1.0, 1.0), (-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0)]
            .map(|(x, y)| Frd::new(0.03 * x, 0.03 * y, 0.0))
            .to_vec(),
        ..RunInfo::default()
    }
}

/// Writes `records` as a finished log below `directory`; returns its path.
pub fn write(directory: &std::path::Path, records: &[Record]) -> std::path::PathBuf {
    let mut writer =
        LogWriter::create(directory, &run_info(), START, Instant::now()).expect("create");
    records.iter().for_each(|record| writer.write(record).expect("written"));
    writer.finish().expect("finish").path
}
