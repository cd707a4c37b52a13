//! Manoeuvres that separate one cause of a vehicle's behaviour from another: a small library of
//! safe flights, as large as the room, the envelope and the vehicle allow.

mod room;
mod script;

use std::path::Path;

pub use self::room::Room;
use self::script::Script;
use super::feasibility::{Feasibility, FlightEnvelope};
use super::file::{Multisine, Wave, YawWave};
use super::trajectory::Trajectory;

/// One manoeuvre of the library.
#[derive(Clone, Debug)]
pub struct Manoeuvre {
    /// Its name in reports.
    pub name: &'static str,
    /// What it distinguishes, as a clause after "because it".
    pub purpose: &'static str,
    /// The trajectory file.
    pub text: String,
    /// The trajectory in that file.
    pub trajectory: Trajectory,
    /// The largest demands of the trajectory.
    pub demands: Feasibility,
}

/// The manoeuvres for a vehicle in a room, without those that exceed the envelope.
pub fn library(room: &Room, envelope: &FlightEnvelope) -> Vec<Manoeuvre> {
    let drawn: [(&'static str, &'static str, String); 16] = [
        (
            "hover-yaw",
            "turns in hover: what is fixed to the body turns with it, what is fixed to the world does not",
            hover_yaw(room),
        ),
        (
            "four-headings",
            "moves alike at four headings: what is fixed to the body turns with it, and steady \
             motion separates from its change",
            four_headings(room),
        ),
        (
            "height-staircase",
            "hovers at one height after another, up and down: what depends on height separates \
             from what depends on time",
            height_staircase(room),
        ),
        (
            "low-hover",
            "hovers close to the floor and further up: the floor's effect fades with height",
            low_hover(room),
        ),
        (
            "vertical-chirp",
            "climbs and sinks ever faster: it shows thrust over its range and beyond its lag",
            vertical_chirp(room),
        ),
        (
            "throttle-punches",
            "climbs and stops hard: it shows thrust well above and below hover",
            throttle_punches(room),
        ),
        (
            "long-hover",
            "drains the pack between hard climbs: it shows the same throttle with a full and with \
             a used pack",
            long_hover(room),
        ),
        (
            "descents",
            "sinks as fast as it climbs: rotors work in their own wake only on the way down",
            descents(room),
        ),
        (
            "speed-sweep",
            "flies along both axes, both ways, at growing speed: it shows the power of the speed, \
             and which way it acts",
            speed_sweep(room),
        ),
        (
            "fast-circle",
            "circles at speed without turning: the air comes from every side of the body",
            fast_circle(room, 0.0),
        ),
        (
            "turning-circle",
            "circles at speed while turning: air, body and world axes all separate",
            fast_circle(room, 0.5),
        ),
        (
            "stops",
            "jumps sideways and stops: how quickly it responds separates from what it responds to",
            stops(room),
        ),
        (
            "tilt-chirp",
            "tilts ever faster: delay, lag, gain and inertia shift the phase in different ways",
            tilt_chirp(room, 0.0),
        ),
        (
            "yaw-chirp",
            "yaws ever faster: yaw torque, yaw inertia and the loop's gain act at different rates",
            yaw_chirp(room),
        ),
        (
            "tilt-while-yawing",
            "tilts fast while it turns: spinning parts respond across the axis",
            tilt_chirp(room, 0.8),
        ),
        ("everything", "moves along and about all axes at once", everything(room)),
    ];
    drawn
        .into_iter()
        .filter_map(|(name, purpose, body)| {
            let text = format!("# {name}: {purpose}\n{body}");
            let trajectory = Trajectory::parse(&text, Path::new(name)).ok()?;
            let demands = envelope.check(&trajectory, room.gravity).ok()?;
            Some(Manoeuvre { name, purpose, text, trajectory, demands })
        })
        .collect()
}

/// Duration of the ramps from and to rest, s.
const RAMP_S: f64 = 2.0;

fn hover_yaw(room: &Room) -> String {
    let rate = (0.4 * room.yaw_rate_deg_s).min(45.0);
    Multisine {
        altitude_m: room.middle(),
        yaw_rate_deg_s: rate,
        duration_s: 720.0 / rate,
        ramp_s: RAMP_S,
        ..Multisine::default()
    }
    .to_toml()
}

fn four_headings(room: &Room) -> String {
    let (height, side) = (room.middle(), (0.5 * room.half_size_m).min(0.8));
    let mut script = Script::new(room).at([0.0, 0.0, height], 0.0, 1.0);
    for quarter in 0..4 {
        let yaw = 90.0 * f64::from(quarter);
        script = script.at([0.0, 0.0, height], yaw, 1.0);
        for [north, east] in [[side, 0.0], [-side, 0.0], [0.0, side], [0.0, -side], [0.0, 0.0]] {
            script = script.at([north, east, height], yaw, 0.0);
        }
    }
    script.to_toml()
}

fn height_staircase(room: &Room) -> String {
    let levels = room.levels(5);
    let up = levels.iter().copied();
    let down = levels.iter().rev().skip(1).copied();
    let script = Script::new(room).climbing();
    up.chain(down).fold(script, |script, height| script.at([0.0, 0.0, height], 0.0, 2.0)).to_toml()
}

fn low_hover(room: &Room) -> String {
    let levels = [1.0, 1.3, 1.7, 2.5, 4.0].map(|times| times * room.lowest_m);
    let levels = levels.map(|height| height.min(room.height_m[1]));
    let down = levels.iter().rev();
    let up = levels.iter().skip(1);
    down.chain(up)
        .fold(Script::new(room).climbing(), |script, height| {
            script.at([0.0, 0.0, *height], 0.0, 2.5)
        })
        .to_toml()
}

/// Waves with equal shares of an acceleration, limited in amplitude and speed.
fn waves(periods_s: &[f64], acceleration: f64, amplitude_max: f64, speed_max: f64) -> Vec<Wave> {
    let count = periods_s.len() as f64;
    periods_s
        .iter()
        .enumerate()
        .map(|(i, period_s)| {
            let omega = std::f64::consts::TAU / period_s;
            let amplitude_m = (acceleration / count / (omega * omega))
                .min(amplitude_max / count)
                .min(speed_max / count / omega);
            // Phases that keep the waves' peaks apart.
            Wave { amplitude_m, period_s: *period_s, phase_deg: 110.0 * i as f64 }
        })
        .collect()
}

fn vertical_chirp(room: &Room) -> String {
    Multisine {
        altitude_m: room.middle(),
        duration_s: 20.0,
        ramp_s: RAMP_S,
        up: waves(&[4.3, 2.3, 1.3, 0.8], room.climb_m_s2, 0.8 * room.half_height(), room.speed_m_s),
        ..Multisine::default()
    }
    .to_toml()
}

/// Up and down as hard as allowed, `times` times.
fn punches(room: &Room, script: Script, times: usize) -> Script {
    let [low, high] = room.height_m;
    (0..times).fold(script, |script, _| {
        script.at([0.0, 0.0, high], 0.0, 0.5).at([0.0, 0.0, low], 0.0, 0.5)
    })
}

fn throttle_punches(room: &Room) -> String {
    let script = Script::new(room).at([0.0, 0.0, room.height_m[0]], 0.0, 1.0);
    punches(room, script.climbing(), 5).to_toml()
}

fn long_hover(room: &Room) -> String {
    let low = [0.0, 0.0, room.height_m[0]];
    let mut script = Script::new(room).climbing().at(low, 0.0, 1.0);
    for _ in 0..3 {
        script = punches(room, script, 2).at(low, 0.0, 25.0);
    }
    punches(room, script, 2).to_toml()
}

fn descents(room: &Room) -> String {
    let amplitude = 0.95 * room.half_height();
    let speed = room.speed_m_s.min((room.climb_m_s2 * amplitude).sqrt());
    let period_s = std::f64::consts::TAU * amplitude / speed;
    Multisine {
        altitude_m: room.middle(),
        duration_s: 20.0,
        ramp_s: RAMP_S,
        up: vec![Wave { amplitude_m: amplitude, period_s, phase_deg: 0.0 }],
        ..Multisine::default()
    }
    .to_toml()
}

fn speed_sweep(room: &Room) -> String {
    let height = room.middle();
    let mut script = Script::new(room).at([0.0, 0.0, height], 0.0, 1.0);
    for axis in 0..2 {
        for share in [0.35, 0.65, 1.0] {
            for side in [share, -share] {
                let mut place = [0.0, 0.0, height];
                place[axis] = side * room.half_size_m;
                script = script.at(place, 0.0, 0.3);
            }
        }
        script = script.at([0.0, 0.0, height], 0.0, 0.5);
    }
    script.to_toml()
}

/// `turning`: fraction of the yaw rate limit.
fn fast_circle(room: &Room, turning: f64) -> String {
    let radius = 0.9 * room.half_size_m;
    let speed = room.speed_m_s.min((room.lateral_m_s2 * radius).sqrt());
    let period_s = std::f64::consts::TAU * radius / speed;
    Multisine {
        altitude_m: room.middle(),
        yaw_rate_deg_s: turning * room.yaw_rate_deg_s,
        duration_s: 20.0,
        ramp_s: RAMP_S,
        north: vec![Wave { amplitude_m: radius, period_s, phase_deg: 0.0 }],
        east: vec![Wave { amplitude_m: radius, period_s, phase_deg: 90.0 }],
        ..Multisine::default()
    }
    .to_toml()
}

fn stops(room: &Room) -> String {
    // Feedback sees at most a metre of error, so the approach to a step has a bounded speed.
    let step = (0.4 * room.half_size_m).min(0.6);
    let mut offsets = Vec::new();
    for [north, east] in [[step, 0.0], [-step, 0.0], [0.0, step], [0.0, -step]] {
        offsets.push(format!("[{north}, {east}, 0.0, 0.0]"));
        offsets.push("[0.0, 0.0, 0.0, 0.0]".to_owned());
    }
    format!(
        "family = \"steps\"\naltitude_m = {}\ndwell_s = 2.0\noffsets = [{}]\n",
        room.middle(),
        offsets.join(", ")
    )
}

/// `turning`: fraction of the yaw rate limit.
fn tilt_chirp(room: &Room, turning: f64) -> String {
    let side = 0.5 * room.half_size_m;
    // Both axes may reach their maximum at once.
    let (acceleration, speed) = (room.lateral_m_s2 / 2f64.sqrt(), room.speed_m_s / 2f64.sqrt());
    let lateral = |periods: &[f64]| waves(periods, acceleration, side, speed);
    Multisine {
        altitude_m: room.middle(),
        yaw_rate_deg_s: turning * room.yaw_rate_deg_s,
        duration_s: 20.0,
        ramp_s: RAMP_S,
        north: lateral(&[2.9, 1.55, 0.95, 0.62]),
        east: lateral(&[2.5, 1.35, 0.85, 0.55]),
        ..Multisine::default()
    }
    .to_toml()
}

fn yaw_waves(room: &Room) -> Vec<YawWave> {
    // Drag torques are small, so the rotors have little yaw authority.
    let periods = [4.1, 2.6, 1.7, 1.1];
    let share = 0.6 * room.yaw_rate_deg_s / periods.len() as f64;
    periods
        .iter()
        .enumerate()
        .map(|(i, period_s)| YawWave {
            amplitude_deg: (share * period_s / std::f64::consts::TAU).min(40.0),
            period_s: *period_s,
            phase_deg: 110.0 * i as f64,
        })
        .collect()
}

fn yaw_chirp(room: &Room) -> String {
    Multisine {
        altitude_m: room.middle(),
        duration_s: 20.0,
        ramp_s: RAMP_S,
        yaw: yaw_waves(room),
        ..Multisine::default()
    }
    .to_toml()
}

fn everything(room: &Room) -> String {
    let side = 0.6 * room.half_size_m;
    // The axes together share speed and acceleration.
    let (lateral, speed) = (0.6 * room.lateral_m_s2, 0.6 * room.speed_m_s);
    Multisine {
        altitude_m: room.middle(),
        yaw_rate_deg_s: 0.25 * room.yaw_rate_deg_s,
        duration_s: 30.0,
        ramp_s: RAMP_S,
        north: waves(&[5.9, 2.3, 0.9], lateral, side, speed),
        east: waves(&[5.1, 2.0, 0.8], lateral, side, speed),
        up: waves(&[7.3, 2.9, 1.1], 0.6 * room.climb_m_s2, 0.7 * room.half_height(), speed),
        yaw: yaw_waves(room)
            .into_iter()
            .map(|wave| YawWave { amplitude_deg: 0.5 * wave.amplitude_deg, ..wave })
            .collect(),
        ..Multisine::default()
    }
    .to_toml()
}
