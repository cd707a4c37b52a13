//! The simulated vehicle of a script: the faults that strike it, the others who command it, and its
//! true state.

use std::time::Duration;

use sitl::autopilot::{self, LinkKind, Mode, Vehicle, VehicleRefused};
use sitl::config::{Autopilot, SitlConfig};
use vehicle::effects::EffectSet;
use vehicle::foreign::Foreign;
use wire::Encoder;
use wire::dialect::*;

use super::channel::Channel;
use super::judge::{Ending, Judge, Seen};
use super::kit::Kit;
use super::script::{Fault, PilotAct, Script, Timed};
use super::tamper::Tamper;
use super::{frame_content, signing};
use crate::clock::HostTime;

const STATION: autopilot::Peer = autopilot::Peer(0);
const PILOT: autopilot::Peer = autopilot::Peer(1);

/// Parameter 2 of MAV_CMD_COMPONENT_ARM_DISARM that also disarms in the air.
const FORCE: f32 = 21196.0;

/// The vehicle as an operator sets it up: a short time-out of the stream, and on ArduCopter direct
/// thrust and a failsafe that watches the station. Its clock runs at `clock_rate` times the host's.
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

/// The vehicle and its pilot. Times are host times, us since the vehicle was first switched on.
pub(super) struct Aircraft<'a> {
    script: &'a Script,
    kit: &'a Kit,
    /// Host time at which it was first switched on.
    epoch: HostTime,
    vehicle: Vehicle,
    booted_us: u64,
    boots: u64,
    tamper: Tamper,
    pilot: Encoder,
}

impl<'a> Aircraft<'a> {
    /// Switches the vehicle on at `epoch`.
    ///
    /// # Errors
    /// The vehicle cannot be simulated.
    pub fn new(script: &'a Script, kit: &'a Kit, epoch: HostTime) -> Result<Self, VehicleRefused> {
        let mut vehicle = built(script, kit, script.seed, epoch)?;
        vehicle.connect(STATION, LinkKind::Datagrams);
        Ok(Self {
            script,
            kit,
            epoch,
            vehicle,
            booted_us: 0,
            boots: 0,
            tamper: Tamper::default(),
            pilot: signing::encoder(script, 200, 190, epoch),
        })
    }

    fn host(&self, now_us: u64) -> HostTime {
        self.epoch + Duration::from_micros(now_us)
    }

    /// Applies the part of a fault that happens at the instant it begins.
    ///
    /// # Errors
    /// The vehicle cannot be simulated.
    pub fn begin(
        &mut self,
        fault: &Fault,
        now_us: u64,
        judge: &mut Judge,
    ) -> Result<(), VehicleRefused> {
        match *fault {
            Fault::Pilot { act } => self.pilot_acts(act, now_us),
            Fault::Rotor { index, loss } => {
                let torque_share = 1.0;
                let wear = Foreign::RotorWear { rotor: index, loss, torque_share };
                self.vehicle.disturb(wear, self.script.seed);
            }
            Fault::Battery { charge } => self.vehicle.drain(charge),
            Fault::Wind { share, towards_rad } => {
                let (sin, cos) = towards_rad.sin_cos();
                self.push([share * cos, share * sin, 0.0]);
            }
            Fault::Dropped { share } => self.push([0.0, 0.0, -share]),
            Fault::Reboot => {
                self.reboot(now_us)?;
                judge.rebooted(now_us);
            }
            _ => {}
        }
        Ok(())
    }

    /// Applies a lasting force to the vehicle, in shares of its weight.
    fn push(&mut self, share: [f64; 3]) {
        let weight_n = self.kit.params.mass * self.kit.params.gravity;
        let everywhere = Foreign::Jet {
            centre_m: [0.0; 2],
            radius_m: 1e6,
            force_n: share.map(|share| share * weight_n),
        };
        self.vehicle.disturb(everywhere, self.script.seed);
    }

    fn reboot(&mut self, now_us: u64) -> Result<(), VehicleRefused> {
        self.boots += 1;
        let seed = self.script.seed.wrapping_add(self.boots);
        self.vehicle = built(self.script, self.kit, seed, self.host(now_us))?;
        self.booted_us = now_us;
        self.vehicle.connect(STATION, LinkKind::Datagrams);
        Ok(())
    }

    fn pilot_acts(&mut self, act: PilotAct, now_us: u64) {
        let mode = match act {
            PilotAct::Position => Mode::Position,
            PilotAct::Hold => Mode::Hold,
            PilotAct::Return => Mode::Return,
            PilotAct::Land => Mode::Land,
            PilotAct::Offboard => Mode::Offboard,
            PilotAct::Arm => return self.pilot_arms([1.0, 0.0], now_us),
            PilotAct::Disarm => return self.pilot_arms([0.0, 0.0], now_us),
            PilotAct::Kill => return self.pilot_arms([0.0, FORCE], now_us),
        };
        let [main, sub] = self.vehicle.mode_command(mode);
        self.pilot_commands(MavCmd::MAV_CMD_DO_SET_MODE, [1.0, main.into(), sub.into()], now_us);
    }

    fn pilot_arms(&mut self, [arm, force]: [f32; 2], now_us: u64) {
        self.pilot_commands(MavCmd::MAV_CMD_COMPONENT_ARM_DISARM, [arm, force, 0.0], now_us);
    }

    fn pilot_commands(&mut self, command: MavCmd, [param1, param2, param3]: [f32; 3], now_us: u64) {
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
        let now = self.host(now_us);
        signing::turn(&mut self.pilot, now);
        self.pilot.encode(&MavMessage::COMMAND_LONG(data), &mut bytes);
        self.vehicle.receive(PILOT, &bytes);
    }

    /// Puts the frames of the vehicle and of others at `now_us` onto the link.
    pub fn send(&mut self, now_us: u64, channel: &mut Channel) {
        let faults = &self.script.faults;
        let Self { vehicle, tamper, .. } = self;
        vehicle.take_output(|peer, frame| {
            if peer == STATION {
                let tampered = tamper.apply(faults, now_us, frame);
                channel.send_down(faults, now_us, tampered, true);
            }
        });
        channel.intrude(faults, now_us);
    }

    /// Passes the frames that arrive by `now_us` to the vehicle.
    pub fn listen(&mut self, now_us: u64, channel: &mut Channel, judge: &mut Judge) {
        let refuses = |timed: &Timed| timed.fault == Fault::Refusals && timed.acts(now_us);
        let refuses = self.script.faults.iter().any(refuses);
        while let Some(frame) = channel.receive_up(now_us) {
            judge.reached(now_us, &frame.bytes);
            match frame_content::message(&frame.bytes) {
                Some(MavMessage::COMMAND_LONG(data)) if refuses => {
                    let denial = self.denial(&data, now_us);
                    channel.send_down(&self.script.faults, now_us, denial, false);
                }
                _ => self.vehicle.receive(STATION, &frame.bytes),
            }
        }
    }

    fn denial(&self, command: &COMMAND_LONG_DATA, now_us: u64) -> Vec<u8> {
        let denied = MavMessage::COMMAND_ACK(COMMAND_ACK_DATA {
            command: command.command,
            result: MavResult::MAV_RESULT_DENIED,
            ..Default::default()
        });
        let mut bytes = Vec::new();
        let [system, component] = [autopilot::SYSTEM_ID, autopilot::COMPONENT_ID];
        let now = self.host(now_us);
        signing::encoder(self.script, system, component, now).encode(&denied, &mut bytes);
        bytes
    }

    /// The vehicle's true state.
    pub fn seen(&self, now_us: u64) -> Seen {
        let state = self.vehicle.plant().state();
        let flight = self.vehicle.flight();
        Seen {
            now_us,
            position: state.position.to_array(),
            velocity: state.velocity.to_array(),
            tilt_rad: state.attitude.tilt(),
            is_armed: flight.armed(),
            obeys: flight.mode() == Mode::Offboard,
        }
    }

    /// Who controls the vehicle at the end.
    pub fn ending(&self) -> Ending {
        let flight = self.vehicle.flight();
        match flight.mode() {
            _ if !flight.armed() => Ending::Landed,
            Mode::Offboard => Ending::Adrift,
            Mode::Hold | Mode::Takeoff => Ending::Holding,
            Mode::Land | Mode::Return => Ending::Failsafe,
            Mode::Position | Mode::Altitude | Mode::Stabilized => Ending::Pilot,
        }
    }

    /// The next time at which the vehicle may send a frame, us.
    pub fn next_event_us(&self) -> u64 {
        self.booted_us + self.vehicle.clock().host_us(self.vehicle.next_event_us())
    }

    /// Advances the vehicle to `now_us`.
    pub fn advance_to(&mut self, now_us: u64) {
        let vehicle_us = self.vehicle.clock().vehicle_us(now_us - self.booted_us);
        self.vehicle.advance_to(vehicle_us);
    }
}

fn built(script: &Script, kit: &Kit, seed: u64, now: HostTime) -> Result<Vehicle, VehicleRefused> {
    let config = set_up(script.autopilot, script.clock_rate);
    let mut vehicle = Vehicle::new(kit.params.clone(), EffectSet::new(), config, seed)?;
    if script.signed {
        vehicle.sign(signing::key(), signing::stamp(now));
    }
    Ok(vehicle)
}
