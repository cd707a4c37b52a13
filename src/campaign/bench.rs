//! One flight of a script: station, vehicle, link and pilot on one virtual clock.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use sitl::autopilot::{self, LinkKind, Mode, Vehicle, VehicleRefused};
use sitl::config::{Autopilot, SitlConfig};
use vehicle::VehicleParams;
use vehicle::effects::EffectSet;
use vehicle::foreign::Foreign;
use wire::Encoder;
use wire::dialect::*;
use wire::transport::Peer;

use super::channel::Channel;
use super::coverage::Coverage;
use super::judge::{Bounds, Ending, Judge, Seen, Violation};
use super::planner::{self, SharedTime};
use super::script::{Fault, PilotAct, Script};
use super::tamper::Tamper;
use super::{signing, word};

use crate::clock::HostTime;
use crate::lockstep;
use crate::log::record::Record;
use crate::station::{PAUSE, Station, StationSettings};
use crate::supervisor::EngagePolicy;

const VEHICLE: Peer = Peer::new(0);
const STATION: autopilot::Peer = autopilot::Peer(0);
const PILOT: autopilot::Peer = autopilot::Peer(1);

/// The judge sees the true state this often, us.
const SEEN_US: u64 = 10_000;
/// The station runs at least this often, us.
const LOOK_US: u64 = 20_000;
/// A commanded flight ends within this; where the pilot switches, the station is stopped then, us.
const LIMIT_US: u64 = 200_000_000;
const SWITCHED_US: u64 = 26_000_000;
/// Without setpoints, the vehicle's failsafe acts within this time, us.
const ADRIFT_US: u64 = 15_000_000;
/// MAV_CMD_COMPONENT_ARM_DISARM's parameter 2 that disarms in the air.
const FORCE: f32 = 21196.0;

/// What a script is flown with.
pub struct Kit {
    /// The station's settings.
    pub settings: StationSettings,
    /// The vehicle.
    pub params: VehicleParams,
    /// What was promised of its setpoints.
    pub bounds: Bounds,
    /// Where the trajectory leads, from its origin: north, east, down, m.
    pub path: Vec<[f64; 3]>,
}

/// How a flight went.
#[derive(Clone, Debug)]
pub struct Flown {
    /// The station's own word.
    pub end: String,
    /// Who had the vehicle at the end; `None` where there was none.
    pub ending: Option<Ending>,
    /// What did not hold.
    pub violations: Vec<Violation>,
    /// Setpoints that left.
    pub setpoints: u64,
    /// s
    pub simulated_s: f64,
    /// In which states of the flight which faults acted.
    pub coverage: Coverage,
    /// Of every byte in both directions.
    pub digest: u32,
}

/// The vehicle as an operator sets it up: a short time-out of the stream, and on ArduCopter thrust as
/// thrust and a failsafe that listens to the station. Its clock runs at `clock_rate` of the host's.
pub fn set_up(autopilot: Autopilot, clock_rate: f64) -> SitlConfig {
    let parameters: &[(&str, f64)] = match autopilot {
        Autopilot::Bundled => &[],
        Autopilot::Px4 => &[("COM_OF_LOSS_T", 0.2)],
        Autopilot::Arducopter => &[
            ("GUID_OPTIONS", 8.0),
            ("ATC_ANGLE_BOOST", 0.0),
            ("GUID_TIMEOUT", 0.2),
            ("FS_GCS_ENABLE", 5.0),
            ("MAV_GCS_SYSID", 254.0),
        ],
    };
    let parameters = parameters.iter().map(|(name, value)| ((*name).to_owned(), *value)).collect();
    let mut config = SitlConfig { autopilot, parameters, ..SitlConfig::default() };
    config.clock.rate = clock_rate;
    config
}

/// Flies a script.
///
/// # Errors
/// A vehicle that cannot be simulated.
pub fn fly(script: &Script, kit: &Kit) -> Result<Flown, VehicleRefused> {
    let vehicle = built(script, kit, script.seed, 0)?;
    let planner_us: SharedTime = Arc::new(AtomicU64::new(0));
    let reference = planner::faulty(script, Arc::clone(&kit.settings.reference), &planner_us);
    let mut session = kit.settings.session.clone();
    session.signing = script.signed.then(signing::settings);
    let settings = StationSettings {
        reference,
        session,
        policy: script.policy,
        search_timeout_s: (script.policy == EngagePolicy::Command)
            .then_some(kit.settings.search_timeout_s.unwrap_or(20.0)),
        ..kit.settings.clone()
    };
    let mut bench = Bench {
        script,
        kit,
        station: Some(Station::new(settings.clone(), lockstep::host_time(0))),
        settings,
        vehicle,
        booted_us: 0,
        boots: 0,
        channel: Channel::new(script.seed),
        tamper: Tamper::default(),
        judge: Judge::new(script, kit.bounds, &kit.path),
        pilot: signing::encoder(script, 200, 190, 0),
        coverage: Coverage::default(),
        planner_us,
        now_us: 0,
        begun_us: 0,
        turned_us: 0,
        seen_us: 0,
        digest: crc32fast::Hasher::new(),
        end: None,
    };
    bench.vehicle.connect(STATION, LinkKind::Datagrams);
    bench.fly()?;
    Ok(bench.flown())
}

fn built(script: &Script, kit: &Kit, seed: u64, now_us: u64) -> Result<Vehicle, VehicleRefused> {
    let config = set_up(script.autopilot, script.clock_rate);
    let mut vehicle = Vehicle::new(kit.params.clone(), EffectSet::new(), config, seed)?;
    if script.signed {
        vehicle.sign(signing::key(), signing::stamp(now_us));
    }
    Ok(vehicle)
}

struct Bench<'a> {
    script: &'a Script,
    kit: &'a Kit,
    settings: StationSettings,
    /// None while its process does not run.
    station: Option<Station>,
    vehicle: Vehicle,
    booted_us: u64,
    boots: u64,
    channel: Channel,
    tamper: Tamper,
    judge: Judge,
    pilot: Encoder,
    coverage: Coverage,
    planner_us: SharedTime,
    now_us: u64,
    /// Faults that begin before this have begun.
    begun_us: u64,
    /// When the station last ran.
    turned_us: u64,
    /// When the judge sees the truth next.
    seen_us: u64,
    digest: crc32fast::Hasher,
    /// The station's word on how the flight ended.
    end: Option<String>,
}

impl Bench<'_> {
    fn now(&self) -> HostTime {
        lockstep::EPOCH + Duration::from_micros(self.now_us)
    }

    fn acts(&self, fault: Fault) -> bool {
        self.script.faults.iter().any(|timed| timed.fault == fault && timed.acts(self.now_us))
    }

    /// From switching on until the station has ended and the vehicle is in good hands.
    fn fly(&mut self) -> Result<(), VehicleRefused> {
        let limit_us = LIMIT_US;
        loop {
            self.planner_us.store(self.now_us, Ordering::Relaxed);
            self.begin_faults()?;
            self.listen();
            self.turn();
            self.deliver_up();
            self.see();
            if self.station.as_ref().is_some_and(Station::is_over) {
                break;
            }
            if self.now_us >= limit_us {
                self.judge.ends(self.now_us, None);
                return Ok(());
            }
            self.advance();
        }
        // The program has ended: nobody answers any more.
        let ended = self.station.take();
        self.end = ended.as_ref().and_then(Station::end).map(|end| format!("{end:?}"));
        let adrift_us = self.now_us + ADRIFT_US;
        while self.ending() == Ending::Adrift && self.now_us < adrift_us {
            self.listen();
            while self.channel.heard(self.now_us).is_some() {}
            self.deliver_up();
            self.advance();
        }
        self.judge.ends(self.now_us, Some(self.ending()));
        Ok(())
    }

    fn flown(self) -> Flown {
        let ending = self.station.is_none().then(|| self.ending());
        Flown {
            end: self.end.unwrap_or_default(),
            ending,
            violations: self.judge.violations().to_vec(),
            setpoints: self.judge.setpoints,
            simulated_s: self.now_us as f64 * 1e-6,
            coverage: self.coverage,
            digest: self.digest.finalize(),
        }
    }

    fn ending(&self) -> Ending {
        let flight = self.vehicle.flight();
        match flight.mode() {
            _ if !flight.armed() => Ending::Landed,
            Mode::Offboard => Ending::Adrift,
            Mode::Hold | Mode::Takeoff => Ending::Holding,
            Mode::Land | Mode::Return => Ending::Failsafe,
            Mode::Position | Mode::Altitude | Mode::Stabilized => Ending::Pilot,
        }
    }

    fn begin_faults(&mut self) -> Result<(), VehicleRefused> {
        let script = self.script;
        let to_us = self.now_us + 1;
        let from_us = std::mem::replace(&mut self.begun_us, to_us);
        for timed in script.faults.iter().filter(|it| it.begins(from_us, to_us)) {
            match timed.fault {
                Fault::Pilot { act } => self.pilot_acts(act),
                Fault::Rotor { index, loss } => {
                    let torque_share = 1.0;
                    let wear = Foreign::RotorWear { rotor: index, loss, torque_share };
                    self.vehicle.disturb(wear, script.seed);
                }
                Fault::Battery { charge } => self.vehicle.drain(charge),
                Fault::Wind { share, towards_rad } => {
                    let (sin, cos) = towards_rad.sin_cos();
                    self.push([share * cos, share * sin, 0.0]);
                }
                Fault::Dropped { share } => self.push([0.0, 0.0, -share]),
                Fault::Reboot => self.reboot()?,
                Fault::Restart => self.station = None,
                _ => {}
            }
        }
        let is_down = self.acts(Fault::Restart);
        if self.station.is_none() && !is_down {
            // As the file that keeps stamps: what was heard until a second before is known.
            if let Some(signing) = &mut self.settings.session.signing {
                signing.before = signing.ledger.get();
            }
            self.station = Some(Station::new(self.settings.clone(), self.now()));
            self.judge.restarted(self.now_us);
            self.turned_us = self.now_us;
        }
        Ok(())
    }

    /// A force on the vehicle from now on, in shares of its weight.
    fn push(&mut self, share: [f64; 3]) {
        let weight_n = self.kit.params.mass * self.kit.params.gravity;
        let everywhere = Foreign::Jet {
            centre_m: [0.0; 2],
            radius_m: 1e6,
            force_n: share.map(|share| share * weight_n),
        };
        self.vehicle.disturb(everywhere, self.script.seed);
    }

    fn reboot(&mut self) -> Result<(), VehicleRefused> {
        self.boots += 1;
        let seed = self.script.seed.wrapping_add(self.boots);
        self.vehicle = built(self.script, self.kit, seed, self.now_us)?;
        self.booted_us = self.now_us;
        self.vehicle.connect(STATION, LinkKind::Datagrams);
        self.judge.rebooted(self.now_us);
        Ok(())
    }

    fn pilot_acts(&mut self, act: PilotAct) {
        let mode = match act {
            PilotAct::Position => Mode::Position,
            PilotAct::Hold => Mode::Hold,
            PilotAct::Return => Mode::Return,
            PilotAct::Land => Mode::Land,
            PilotAct::Offboard => Mode::Offboard,
            PilotAct::Arm => return self.pilot_arms(1.0, 0.0),
            PilotAct::Disarm => return self.pilot_arms(0.0, 0.0),
            PilotAct::Kill => return self.pilot_arms(0.0, FORCE),
        };
        let [main, sub] = self.vehicle.mode_command(mode);
        self.pilot_commands(MavCmd::MAV_CMD_DO_SET_MODE, [1.0, main.into(), sub.into()]);
    }

    fn pilot_arms(&mut self, arm: f32, force: f32) {
        self.pilot_commands(MavCmd::MAV_CMD_COMPONENT_ARM_DISARM, [arm, force, 0.0]);
    }

    fn pilot_commands(&mut self, command: MavCmd, [param1, param2, param3]: [f32; 3]) {
        let data = COMMAND_LONG_DATA {
            param1,
            param2,
            param3,
            command,
            target_system: autopilot::SYSTEM_ID,
            target_component: autopilot::COMPONENT_ID,
            ..Default::default()
        };
        let mut bytes = Vec::new();
        signing::turn(&mut self.pilot, self.now_us);
        self.pilot.encode(&MavMessage::COMMAND_LONG(data), &mut bytes);
        self.vehicle.receive(PILOT, &bytes);
    }

    /// What the vehicle and others say, onto the link.
    fn listen(&mut self) {
        let now_us = self.now_us;
        let faults = &self.script.faults;
        let Self { vehicle, channel, tamper, .. } = self;
        vehicle.take_output(|peer, frame| {
            if peer == STATION {
                let told = tamper.apply(faults, now_us, frame);
                channel.say(faults, now_us, told, true);
            }
        });
        channel.intrude(faults, now_us);
    }

    /// A turn of the station's process: reads what arrived, answers, looks at the clock.
    fn turn(&mut self) {
        let now_us = self.now_us;
        if self.station.is_none() {
            // Nobody reads: the system drops what comes.
            while self.channel.heard(now_us).is_some() {}
            return;
        }
        if self.acts(Fault::Pause) {
            return;
        }
        let now = self.now();
        let stood = Duration::from_micros(now_us - self.turned_us);
        self.turned_us = now_us;
        self.judge.runs(now_us);
        while let Some(frame) = self.channel.heard(now_us) {
            self.digest.update(&frame.bytes);
            let Self { judge, station: Some(station), .. } = self else { return };
            judge.heard(now_us, &frame);
            if stood > PAUSE {
                station.catch_up(now, VEHICLE, &frame.bytes, true);
            } else {
                station.receive(now, VEHICLE, &frame.bytes, true);
                self.transmit();
            }
        }
        let is_stuck = self.acts(Fault::LogStuck);
        let Some(station) = &mut self.station else { return };
        if stood > PAUSE {
            station.resumed(now, stood);
        }
        station.poll(now);
        if self.script.policy == EngagePolicy::PilotSwitch && now_us >= SWITCHED_US {
            station.land(now);
        }
        if !is_stuck {
            station.take_records(|record| {
                if let Record::Event { source, text, .. } = record {
                    tracing::debug!("{:.3} s, {source:?}: {text}", now_us as f64 * 1e-6);
                }
            });
        }
        self.transmit();
    }

    fn transmit(&mut self) {
        let (now, now_us) = (self.now(), self.now_us);
        let is_jammed = self.acts(Fault::Jammed);
        let Self { station, channel, judge, script, digest, .. } = self;
        let Some(station) = station else { return };
        station.transmit(now, |_, frame| {
            if is_jammed {
                return false;
            }
            digest.update(frame);
            judge.said(now_us, frame);
            channel.answer(&script.faults, now_us, frame);
            true
        });
    }

    fn deliver_up(&mut self) {
        let refuses = self.acts(Fault::Refusals);
        while let Some(frame) = self.channel.asked(self.now_us) {
            self.judge.reached(self.now_us, &frame.bytes);
            match word::message(&frame.bytes) {
                Some(MavMessage::COMMAND_LONG(data)) if refuses => self.deny(&data),
                _ => self.vehicle.receive(STATION, &frame.bytes),
            }
        }
    }

    fn deny(&mut self, asked: &COMMAND_LONG_DATA) {
        let denied = MavMessage::COMMAND_ACK(COMMAND_ACK_DATA {
            command: asked.command,
            result: MavResult::MAV_RESULT_DENIED,
            ..Default::default()
        });
        let mut bytes = Vec::new();
        let [system, component] = [autopilot::SYSTEM_ID, autopilot::COMPONENT_ID];
        signing::encoder(self.script, system, component, self.now_us).encode(&denied, &mut bytes);
        self.channel.say(&self.script.faults, self.now_us, bytes, false);
    }

    fn see(&mut self) {
        if self.now_us < self.seen_us {
            return;
        }
        self.seen_us = self.now_us + SEEN_US;
        let state = self.vehicle.plant().state();
        let flight = self.vehicle.flight();
        let seen = Seen {
            now_us: self.now_us,
            position: state.position.to_array(),
            speed: state.velocity.norm(),
            tilt_rad: state.attitude.tilt(),
            is_armed: flight.armed(),
            obeys: flight.mode() == Mode::Offboard,
        };
        self.judge.sees(&seen);
        let phase = self.station.as_ref().and_then(|station| station.status().phase);
        self.coverage.note(phase, &self.script.faults, self.now_us);
    }

    fn advance(&mut self) {
        let clock = self.vehicle.clock();
        let event_us = self.booted_us + clock.host_us(self.vehicle.next_event_us());
        let next_us = event_us
            .min(self.channel.next_us().max(self.now_us + 1))
            .min(self.now_us + LOOK_US)
            .min(self.next_fault_us());
        self.now_us = next_us.max(self.now_us + 1);
        let vehicle_us = clock.vehicle_us(self.now_us - self.booted_us);
        self.vehicle.advance_to(vehicle_us);
    }

    /// When the next fault begins or ends, us.
    fn next_fault_us(&self) -> u64 {
        let times = self.script.faults.iter().flat_map(|timed| [timed.at_us(), timed.end_us()]);
        times.filter(|at| *at > self.now_us).min().unwrap_or(u64::MAX)
    }
}
