//! A motion-capture room around the simulated vehicle, sans I/O. It captures the true state with a
//! room's rate, noise and faults, and encodes it as lines of JSON and as NatNet 4.1.
//!
//! Its bodies are `quad` (1 in NatNet), the vehicle, and `cart` (2), a body on the floor.

use std::collections::VecDeque;
use std::fmt;
use std::str::FromStr;

use rand::{Rng, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64Mcg;
use serde_json::json;
use vehicle::frame::{Attitude, Ned};

/// Lead of the room's clock over the simulation's, s: the room was switched on earlier.
const AHEAD_S: f64 = 4321.0;
/// Latency from exposure to sending, us.
const LATENCY_US: u64 = 4_000;
/// Standard deviation of a position on each axis, m.
const NOISE_M: f64 = 2e-4;
/// Standard deviation of an attitude, about each axis, rad.
const NOISE_RAD: f64 = 2e-3;
/// Position of the other body.
const CART: Ned = Ned::new(1.5, 1.0, -0.2);
/// Rate of the clock of NatNet's time stamps, Hz.
const TICKS_HZ: u64 = 10_000_000;

/// Axis of the room that points up.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "server", derive(clap::ValueEnum))]
pub enum RoomUp {
    /// The z axis points up.
    #[default]
    Z,
    /// The y axis points up.
    Y,
}

/// Kind of a room's fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RoomFaultKind {
    /// The two bodies swap names.
    Swap,
    /// The room repeats the last poses with new time stamps.
    Freeze,
    /// The room sends nothing.
    DropOut,
}

impl RoomFaultKind {
    const ALL: [Self; 3] = [Self::Swap, Self::Freeze, Self::DropOut];

    fn name(self) -> &'static str {
        match self {
            Self::Swap => "swap",
            Self::Freeze => "freeze",
            Self::DropOut => "drop-out",
        }
    }
}

/// A fault with its start and duration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RoomFault {
    /// Kind of the fault.
    pub kind: RoomFaultKind,
    /// Start, s after the vehicle first arms.
    pub at_s: f64,
    /// Duration, s; may be infinite.
    pub for_s: f64,
}

impl FromStr for RoomFault {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let error = || {
            format!(
                "{text:?}: expected swap, freeze or drop-out, @ and seconds, such as freeze@8 or swap@8+2"
            )
        };
        let (name, times) = text.split_once('@').ok_or_else(error)?;
        let mut kinds = RoomFaultKind::ALL.into_iter();
        let kind = kinds.find(|kind| kind.name() == name).ok_or_else(error)?;
        let (at, length) = times.split_once('+').unwrap_or((times, "inf"));
        let time = |text: &str| text.parse().ok().filter(|time: &f64| *time >= 0.0);
        let (at_s, for_s) = time(at).zip(time(length)).ok_or_else(error)?;
        Ok(Self { kind, at_s, for_s })
    }
}

impl fmt::Display for RoomFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}@{}+{}", self.kind.name(), self.at_s, self.for_s)
    }
}

/// Settings of a room.
#[derive(Clone, Debug, PartialEq)]
pub struct RoomConfig {
    /// Frames per second.
    pub rate_hz: f64,
    /// The axis that points up.
    pub up: RoomUp,
    /// Heading of the x axis, clockwise from north, degrees.
    pub x_heading_deg: f64,
    /// Faults of the room.
    pub faults: Vec<RoomFault>,
}

/// A body as captured, in the room's axes.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Body {
    name: &'static str,
    number: i32,
    position_m: [f64; 3],
    rotation: Attitude,
}

/// A captured frame that waits to be sent.
#[derive(Clone, Debug)]
pub struct RoomFrame {
    number: i32,
    captured_us: u64,
    bodies: Vec<Body>,
}

/// A simulated motion-capture room.
#[derive(Clone, Debug)]
pub struct Room {
    config: RoomConfig,
    rng: Pcg64Mcg,
    next_us: f64,
    frames: i32,
    armed_us: Option<u64>,
    latest: Vec<Body>,
    leaving: VecDeque<RoomFrame>,
}

impl Room {
    /// Creates a room that starts at time 0; `seed` seeds its noise.
    pub fn new(config: RoomConfig, seed: u64) -> Self {
        let rng = Pcg64Mcg::seed_from_u64(seed ^ 0x6d6f_6361);
        Self {
            config,
            rng,
            next_us: 0.0,
            frames: 0,
            armed_us: None,
            latest: Vec::new(),
            leaving: VecDeque::new(),
        }
    }

    /// Time at which the room next captures or sends a frame, us.
    pub fn next_us(&self) -> u64 {
        let leaves = self.leaving.front().map(|frame| frame.captured_us + LATENCY_US);
        leaves.unwrap_or(u64::MAX).min(self.next_us.ceil() as u64)
    }

    /// Captures the vehicle's pose at `now_us` if a frame is due.
    pub fn look(&mut self, now_us: u64, position: Ned, attitude: Attitude, is_armed: bool) {
        if is_armed {
            self.armed_us.get_or_insert(now_us);
        }
        if (now_us as f64) < self.next_us {
            return;
        }
        self.next_us = (self.next_us + 1e6 / self.config.rate_hz).max(now_us as f64 + 1.0);
        self.frames = self.frames.wrapping_add(1);
        let is_on = |kind| {
            let since_s = self.armed_us.map(|at| now_us.saturating_sub(at) as f64 * 1e-6);
            since_s.is_some_and(|s| {
                let begun = |fault: &&RoomFault| fault.kind == kind && s >= fault.at_s;
                self.config.faults.iter().filter(begun).any(|fault| s < fault.at_s + fault.for_s)
            })
        };
        let [drops, swaps, freezes] =
            [RoomFaultKind::DropOut, RoomFaultKind::Swap, RoomFaultKind::Freeze].map(is_on);
        if drops {
            return;
        }
        if !freezes || self.latest.is_empty() {
            let quad = self.body("quad", 1, position, attitude);
            let cart = self.body("cart", 2, CART, Attitude::default());
            self.latest = vec![quad, cart];
        }
        let mut bodies = self.latest.clone();
        if let [a, b] = bodies.as_mut_slice()
            && swaps
        {
            std::mem::swap(&mut a.name, &mut b.name);
            std::mem::swap(&mut a.number, &mut b.number);
        }
        let number = self.frames;
        self.leaving.push_back(RoomFrame { number, captured_us: now_us, bodies });
    }

    /// Returns the next frame whose latency has passed at `now_us`.
    pub fn take(&mut self, now_us: u64) -> Option<RoomFrame> {
        let leaves = self.leaving.front()?.captured_us + LATENCY_US <= now_us;
        if leaves { self.leaving.pop_front() } else { None }
    }

    /// Captures a body, in the room's axes, with noise.
    fn body(&mut self, name: &'static str, number: i32, position: Ned, attitude: Attitude) -> Body {
        let mut normals =
            || -> [f64; 3] { std::array::from_fn(|_| self.rng.sample(StandardNormal)) };
        let position = position + Ned::from(normals()) * NOISE_M;
        let [x, y, z] = normals().map(|normal| 0.5 * NOISE_RAD * normal);
        let attitude = attitude.compose(Attitude { w: 1.0, x, y, z }).normalized();
        let (sin, cos) = self.config.x_heading_deg.to_radians().sin_cos();
        let [north, east, down] = position.to_array();
        let half = std::f64::consts::FRAC_1_SQRT_2;
        // Rotation between the room's axes and north, east, down where x points north.
        let (upright, position_m) = match self.config.up {
            RoomUp::Z => (
                Attitude { w: 0.0, x: 1.0, y: 0.0, z: 0.0 },
                [north * cos + east * sin, north * sin - east * cos, -down],
            ),
            RoomUp::Y => (
                Attitude { w: half, x: -half, y: 0.0, z: 0.0 },
                [north * cos + east * sin, -down, east * cos - north * sin],
            ),
        };
        let back = -0.5 * self.config.x_heading_deg.to_radians();
        let turned = Attitude { w: back.cos(), x: 0.0, y: 0.0, z: back.sin() };
        let rotation =
            upright.inverse().compose(turned).compose(attitude).compose(upright).normalized();
        Body { name, number, position_m, rotation }
    }
}

impl RoomFrame {
    fn captured_s(&self) -> f64 {
        self.captured_us as f64 * 1e-6 + AHEAD_S
    }

    /// Encodes the frame as a datagram of JSON lines, one for each body.
    pub fn lines(&self) -> Vec<u8> {
        let line = |body: &Body| {
            let Attitude { w, x, y, z } = body.rotation;
            let line = json!({
                "body": body.name,
                "t": self.captured_s(),
                "p": body.position_m,
                "q": [w, x, y, z],
                "sent": self.captured_s() + LATENCY_US as f64 * 1e-6,
            });
            line.to_string() + "\n"
        };
        self.bodies.iter().map(line).collect::<String>().into_bytes()
    }

    /// Encodes the frame as NatNet 4.1 message 7, with rigid bodies and time stamps.
    pub fn natnet(&self) -> Vec<u8> {
        let mut out = self.number.to_le_bytes().to_vec();
        let mut section = |count: usize, content: &[u8]| {
            out.extend((count as i32).to_le_bytes());
            out.extend((content.len() as i32).to_le_bytes());
            out.extend(content);
        };
        let mut bodies = Vec::new();
        for body in &self.bodies {
            bodies.extend(body.number.to_le_bytes());
            let Attitude { w, x, y, z } = body.rotation;
            for value in body.position_m.into_iter().chain([x, y, z, w, NOISE_M]) {
                bodies.extend((value as f32).to_le_bytes());
            }
            bodies.extend(1u16.to_le_bytes());
        }
        // Marker sets and other markers come before; skeletons, assets, labelled markers, plates
        // and devices come after.
        section(0, &[]);
        section(0, &[]);
        section(self.bodies.len(), &bodies);
        (0..5).for_each(|_| section(0, &[]));
        let ticks = |us: u64| us * (TICKS_HZ / 1_000_000) + AHEAD_S as u64 * TICKS_HZ;
        out.extend([0; 8]);
        out.extend(self.captured_s().to_le_bytes());
        for us in [self.captured_us, self.captured_us + 2_000, self.captured_us + LATENCY_US] {
            out.extend(ticks(us).to_le_bytes());
        }
        // The precise time stamp, the parameters and the end mark.
        out.extend([0; 8 + 2 + 4]);
        packet(7, &out)
    }
}

/// NatNet message 1, the server's description.
pub fn natnet_server() -> Vec<u8> {
    let mut payload = vec![0; 256];
    payload.iter_mut().zip(b"downwash sitl").for_each(|(to, from)| *to = *from);
    payload.extend([1, 0, 0, 0, 4, 1, 0, 0]);
    payload.extend(TICKS_HZ.to_le_bytes());
    // Data port, multicast flag and multicast group.
    payload.extend([0; 7]);
    packet(1, &payload)
}

/// The message number of a request to a NatNet server: 0 connects, 10 keeps the connection alive.
/// Returns `None` for any other datagram.
pub fn natnet_request(datagram: &[u8]) -> Option<u16> {
    let [low, high, ..] = datagram else { return None };
    Some(u16::from_le_bytes([*low, *high])).filter(|message| matches!(message, 0 | 10))
}

fn packet(message: u16, payload: &[u8]) -> Vec<u8> {
    [&message.to_le_bytes()[..], &(payload.len() as u16).to_le_bytes(), payload].concat()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn room(faults: &[&str]) -> Room {
        let faults = faults.iter().map(|fault| fault.parse().expect("a fault")).collect();
        let config = RoomConfig { rate_hz: 100.0, up: RoomUp::Z, x_heading_deg: 0.0, faults };
        Room::new(config, 1)
    }

    /// Reported positions of `quad`, frame by frame, while it climbs at 1 m/s, armed at 0.
    fn positions(room: &mut Room, seconds: f64) -> Vec<[f64; 3]> {
        let mut positions = Vec::new();
        for ms in 0..(seconds * 1e3) as u64 {
            let now_us = 1000 * ms;
            let place = Ned::new(0.0, 0.0, -1e-6 * now_us as f64);
            room.look(now_us, place, Attitude::default(), true);
            while let Some(frame) = room.take(now_us) {
                positions
                    .extend(frame.bodies.iter().filter(|b| b.number == 1).map(|b| b.position_m));
            }
        }
        positions
    }

    #[test]
    fn room_reports_the_vehicle_at_its_rate_with_noise() {
        let positions = positions(&mut room(&[]), 2.0);
        assert_eq!(positions.len(), 200);
        let error = |(k, place): (usize, &[f64; 3])| (place[2] - 0.01 * k as f64).abs();
        let errors: Vec<f64> = positions.iter().enumerate().map(error).collect();
        assert!(errors.iter().all(|e| *e < 2e-3) && errors.iter().sum::<f64>() > 0.01);
    }

    #[test]
    fn room_faults_start_and_end_on_time() {
        assert_eq!(positions(&mut room(&["drop-out@0.5+0.5"]), 2.0).len(), 150);
        let frozen = positions(&mut room(&["freeze@0.5+0.5"]), 2.0);
        let same = frozen.windows(2).filter(|pair| pair[0] == pair[1]).count();
        assert_eq!((frozen.len(), same), (200, 50));
        let swapped = positions(&mut room(&["swap@0.5+0.5"]), 2.0);
        assert_eq!(swapped.iter().filter(|place| (place[0] - 1.5).abs() < 0.01).count(), 50);
        for wrong in ["", "swap", "swap@", "swap@-1", "melt@3", "freeze@1+x", "freeze@nan"] {
            assert!(wrong.parse::<RoomFault>().is_err(), "{wrong}");
        }
    }
}
