//! The link between vehicle and station, with its faults.

use std::collections::{BTreeMap, VecDeque};

use wire::Encoder;
use wire::dialect::*;

use super::frame_content;
use super::script::{Fault, Timed, Way};
use crate::exam::draw::Draw;

/// Time for which frames are remembered, us.
const REMEMBERED_US: u64 = 6_000_000;
/// Most frames in transit; further ones are lost, as in a full buffer.
const FRAMES_MAX: usize = 20_000;

/// The origin of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Origin {
    /// The vehicle sent exactly this, and it arrives for the first time.
    Vehicle,
    /// The vehicle sent it, and it arrived before.
    Copy,
    /// The vehicle never sent it, or sent something different.
    Nobody,
}

/// A frame in transit.
#[derive(Clone, Debug)]
pub(super) struct Passing {
    /// Time of arrival, us.
    pub arrival_us: u64,
    /// Time at which the vehicle sent it, us.
    pub sent_us: u64,
    pub origin: Origin,
    pub bytes: Vec<u8>,
}

#[derive(Default)]
struct Queue {
    frames: BTreeMap<(u64, u64), Passing>,
    entered: u64,
}

impl Queue {
    fn push(&mut self, passing: Passing) {
        self.entered += 1;
        if self.frames.len() < FRAMES_MAX {
            self.frames.insert((passing.arrival_us, self.entered), passing);
        }
    }

    fn pop(&mut self, now_us: u64) -> Option<Passing> {
        let first = self.frames.first_entry().filter(|entry| entry.key().0 <= now_us)?;
        Some(first.remove())
    }

    fn next_us(&self) -> Option<u64> {
        self.frames.first_key_value().map(|((arrival_us, _), _)| *arrival_us)
    }
}

/// Both directions of the link.
pub(super) struct Channel {
    draw: Draw,
    down: Queue,
    up: Queue,
    remembered: VecDeque<(u64, Vec<u8>)>,
    /// When the next replay, foreign frame and injected setpoint are due, us.
    next_intrusion_us: [u64; 3],
    foreign: Encoder,
    injector: Encoder,
}

impl Channel {
    pub fn new(seed: u64) -> Self {
        Self {
            draw: Draw::new(seed, 1),
            down: Queue::default(),
            up: Queue::default(),
            remembered: VecDeque::new(),
            next_intrusion_us: [0; 3],
            foreign: Encoder::new(42, 1),
            injector: Encoder::new(240, 190),
        }
    }

    /// Takes a frame from the vehicle; `is_true` means that no fault changed it.
    pub fn send_down(&mut self, faults: &[Timed], now_us: u64, bytes: Vec<u8>, is_true: bool) {
        let is_mode = frame_content::is_mode(&bytes);
        if is_mode && acting(faults, now_us).any(|fault| fault == Fault::ModeLost) {
            return;
        }
        self.pass(faults, now_us, bytes, true, is_true);
    }

    /// Takes a frame from the station.
    pub fn send_up(&mut self, faults: &[Timed], now_us: u64, bytes: &[u8]) {
        self.pass(faults, now_us, bytes.to_vec(), false, true);
    }

    fn pass(
        &mut self,
        faults: &[Timed],
        now_us: u64,
        mut bytes: Vec<u8>,
        is_down: bool,
        is_true: bool,
    ) {
        let is_affected = |way: Way| if is_down { way.is_down() } else { way.is_up() };
        let (mut arrival_us, mut copy_us, mut origin) =
            (now_us, None, if is_true { Origin::Vehicle } else { Origin::Nobody });
        for fault in acting(faults, now_us) {
            match fault {
                Fault::Cut { way } if is_affected(way) => return,
                Fault::Loss { way, share } if is_affected(way) && self.draw.chance(share) => return,
                Fault::Delay { way, least_s, jitter_s } if is_affected(way) => {
                    arrival_us += ((least_s + self.draw.within([0.0, jitter_s])) * 1e6) as u64;
                }
                Fault::Duplicates { share, after_s } if self.draw.chance(share) => {
                    copy_us = Some((after_s * 1e6) as u64);
                }
                Fault::Corruption { share } if self.draw.chance(share) => {
                    let at = self.draw.below(bytes.len());
                    let bits = 1 + self.draw.below(255) as u8;
                    if let Some(byte) = bytes.get_mut(at) {
                        *byte ^= bits;
                    }
                    origin = Origin::Nobody;
                }
                _ => {}
            }
        }
        let queue = if is_down { &mut self.down } else { &mut self.up };
        if let Some(after_us) = copy_us {
            let bytes = bytes.clone();
            let arrival_us = arrival_us + after_us;
            let origin = if origin == Origin::Vehicle { Origin::Copy } else { origin };
            queue.push(Passing { arrival_us, sent_us: now_us, origin, bytes });
        }
        queue.push(Passing { arrival_us, sent_us: now_us, origin, bytes });
    }

    /// Adds the frames that others send at `now_us`.
    pub fn intrude(&mut self, faults: &[Timed], now_us: u64) {
        for fault in acting(faults, now_us) {
            let (index, rate_hz) = match fault {
                Fault::Replay { rate_hz, .. } => (0, rate_hz),
                Fault::Foreign { .. } => (1, 10.0),
                Fault::Injected { .. } => (2, 20.0),
                _ => continue,
            };
            if self.next_intrusion_us[index] > now_us {
                continue;
            }
            self.next_intrusion_us[index] = now_us + (1e6 / rate_hz.clamp(0.1, 1000.0)) as u64;
            match fault {
                Fault::Replay { age_s, .. } => self.replay(now_us, age_s),
                Fault::Foreign { system } => self.interfere(now_us, system),
                Fault::Injected { thrust, pitch_rad } => self.inject(now_us, thrust, pitch_rad),
                _ => {}
            }
        }
    }

    fn replay(&mut self, now_us: u64, age_s: f64) {
        let until_us = now_us.saturating_sub(100_000);
        let from_us = now_us.saturating_sub((age_s * 1e6) as u64);
        let only_mode = self.draw.chance(0.7);
        let old: Vec<&(u64, Vec<u8>)> = self
            .remembered
            .iter()
            .filter(|(at, bytes)| {
                (from_us..until_us).contains(at) && (!only_mode || frame_content::is_mode(bytes))
            })
            .collect();
        if old.is_empty() {
            return;
        }
        let (sent_us, bytes) = old[self.draw.below(old.len())].clone();
        self.down.push(Passing { arrival_us: now_us, sent_us, origin: Origin::Copy, bytes });
    }

    /// Sends a frame of a foreign vehicle or ground station.
    fn interfere(&mut self, now_us: u64, system: u8) {
        if self.draw.chance(0.1) {
            self.foreign = Encoder::new(system, if system == 255 { 190 } else { 1 });
        }
        let heartbeat = MavMessage::HEARTBEAT(HEARTBEAT_DATA {
            custom_mode: [0, 4, 0x0006_0000, 0x0304_0000][self.draw.below(4)],
            mavtype: if system == 255 {
                MavType::MAV_TYPE_GCS
            } else {
                MavType::MAV_TYPE_QUADROTOR
            },
            autopilot: match system {
                255 => MavAutopilot::MAV_AUTOPILOT_INVALID,
                2 => MavAutopilot::MAV_AUTOPILOT_ARDUPILOTMEGA,
                _ => MavAutopilot::MAV_AUTOPILOT_PX4,
            },
            base_mode: MavModeFlag::MAV_MODE_FLAG_CUSTOM_MODE_ENABLED,
            system_status: MavState::MAV_STATE_ACTIVE,
            mavlink_version: 3,
        });
        let odometry = MavMessage::ODOMETRY(ODOMETRY_DATA {
            time_usec: now_us,
            x: 50.0,
            q: [1.0, 0.0, 0.0, 0.0],
            frame_id: MavFrame::MAV_FRAME_LOCAL_NED,
            child_frame_id: MavFrame::MAV_FRAME_LOCAL_NED,
            ..Default::default()
        });
        // Without signatures an impostor with the vehicle's own ids cannot be distinguished from
        // the vehicle, so only another component of system 1 sends.
        if system == 1 {
            self.foreign = Encoder::new(1, 191);
        }
        let message = if self.draw.chance(0.3) { heartbeat } else { odometry };
        let mut bytes = Vec::new();
        self.foreign.encode(&message, &mut bytes);
        self.down.push(Passing {
            arrival_us: now_us,
            sent_us: now_us,
            origin: Origin::Nobody,
            bytes,
        });
    }

    fn inject(&mut self, now_us: u64, thrust: f64, pitch_rad: f64) {
        let (sin, cos) = (0.5 * pitch_rad).sin_cos();
        let target = MavMessage::SET_ATTITUDE_TARGET(SET_ATTITUDE_TARGET_DATA {
            q: [cos as f32, 0.0, sin as f32, 0.0],
            thrust: thrust as f32,
            target_system: sitl::autopilot::SYSTEM_ID,
            target_component: sitl::autopilot::COMPONENT_ID,
            type_mask: AttitudeTargetTypemask::from_bits_retain(0x07),
            ..Default::default()
        });
        let mut bytes = Vec::new();
        self.injector.encode(&target, &mut bytes);
        self.up.push(Passing {
            arrival_us: now_us,
            sent_us: now_us,
            origin: Origin::Nobody,
            bytes,
        });
    }

    /// The next frame that has reached the station by `now_us`.
    pub fn receive_down(&mut self, now_us: u64) -> Option<Passing> {
        let passing = self.down.pop(now_us)?;
        if passing.origin == Origin::Vehicle {
            self.remembered.push_back((passing.sent_us, passing.bytes.clone()));
        }
        while self.remembered.front().is_some_and(|(at, _)| at + REMEMBERED_US < now_us) {
            self.remembered.pop_front();
        }
        Some(passing)
    }

    /// The next frame that has reached the vehicle by `now_us`.
    pub fn receive_up(&mut self, now_us: u64) -> Option<Passing> {
        self.up.pop(now_us)
    }

    /// The next arrival of a frame in either direction, us.
    pub fn next_us(&self) -> u64 {
        let next = [self.down.next_us(), self.up.next_us()];
        next.into_iter().flatten().min().unwrap_or(u64::MAX)
    }
}

fn acting(faults: &[Timed], now_us: u64) -> impl Iterator<Item = Fault> {
    faults.iter().filter(move |timed| timed.acts(now_us)).map(|timed| timed.fault)
}
