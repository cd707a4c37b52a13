//! Commands: executes and acknowledges COMMAND_LONG and COMMAND_INT.

use wire::dialect::*;

use super::{Protocol, Sender};
use crate::autopilot::arming::Refusal;
use crate::autopilot::commands::{Acknowledgement, Command};
use crate::autopilot::streams::Stream;
use crate::autopilot::{Mode, identity};

/// Parameter 2 of MAV_CMD_COMPONENT_ARM_DISARM that forces arming or disarming.
const FORCE: f32 = 21196.0;

impl Protocol {
    pub(super) fn acknowledge(&mut self, to: Sender, command: u16, result: MavResult) {
        let acknowledgement = Acknowledgement {
            command,
            result,
            target_system: to.system,
            target_component: to.component,
        };
        if let Some(link) = self.links.get_mut(to.link) {
            link.send_data(&acknowledgement, &mut self.outbox);
        }
    }

    pub(super) fn command(&mut self, sender: Sender, command: &Command) {
        let result = match command.id {
            None => Some(MavResult::MAV_RESULT_UNSUPPORTED),
            Some(id) => self.execute(sender, id, command),
        };
        if let Some(result) = result {
            self.acknowledge(sender, command.number, result);
        }
    }

    /// Executes a command. Returns the result, unless it is already acknowledged.
    fn execute(&mut self, sender: Sender, id: MavCmd, command: &Command) -> Option<MavResult> {
        let now = self.now_us;
        Some(match id {
            MavCmd::MAV_CMD_COMPONENT_ARM_DISARM => self.arm_or_disarm(command),
            MavCmd::MAV_CMD_DO_SET_MODE => {
                let custom = command.param(1) as u32 & 1 != 0;
                let (main, sub) = (command.param(2) as u8, command.param(3) as u8);
                let mode = self.flight.personality.mode_of_command(main, sub);
                if let Some(answer) = self.flight.personality.early_answer() {
                    self.acknowledge(sender, command.number, answer);
                    // A second acknowledgement follows only if the early one was wrong.
                    let result = self.set_mode(custom, mode);
                    return (result != answer).then_some(result);
                }
                self.set_mode(custom, mode)
            }
            MavCmd::MAV_CMD_NAV_TAKEOFF => {
                // Parameter 7 is the altitude above sea level; a value below home is ignored.
                let altitude = f64::from(command.param(7));
                let home = match self.flight.personality.takes_off_to_height() {
                    true => 0.0,
                    false => self.origin.altitude_m - self.flight.home().down(),
                };
                let height = Some(altitude - home).filter(|height| *height > 0.1);
                result(self.flight.request_take_off(now, height))
            }
            MavCmd::MAV_CMD_NAV_LAND => result(self.flight.request_mode(now, Mode::Land)),
            MavCmd::MAV_CMD_NAV_RETURN_TO_LAUNCH => {
                result(self.flight.request_mode(now, Mode::Return))
            }
            MavCmd::MAV_CMD_NAV_LOITER_UNLIM => result(self.flight.request_mode(now, Mode::Hold)),
            MavCmd::MAV_CMD_DO_FLIGHTTERMINATION if command.param(1) > 0.5 => {
                result(self.flight.disarm(true))
            }
            MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL => self.set_interval(sender, command),
            MavCmd::MAV_CMD_GET_MESSAGE_INTERVAL => {
                let id = command.param(1) as u16;
                let interval_us = self.links[sender.link].schedule.interval(id.into());
                let data = MESSAGE_INTERVAL_DATA { interval_us, message_id: id };
                self.reply(sender, &MavMessage::MESSAGE_INTERVAL(data));
                MavResult::MAV_RESULT_ACCEPTED
            }
            MavCmd::MAV_CMD_REQUEST_MESSAGE => self.request_message(sender, command),
            MavCmd::MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES => {
                self.send_once(sender, Stream::AutopilotVersion)
            }
            MavCmd::MAV_CMD_REQUEST_PROTOCOL_VERSION => {
                self.send_once(sender, Stream::ProtocolVersion)
            }
            MavCmd::MAV_CMD_GET_HOME_POSITION => self.send_once(sender, Stream::HomePosition),
            MavCmd::MAV_CMD_RUN_PREARM_CHECKS => {
                let mode = self.flight.commander.mode();
                let text = match self.flight.preflight(now).refusal(mode) {
                    Some(refusal) => format!("Preflight: {refusal}"),
                    None => "Preflight: ready".to_owned(),
                };
                self.flight.commander.notify(MavSeverity::MAV_SEVERITY_INFO, text);
                MavResult::MAV_RESULT_ACCEPTED
            }
            _ => MavResult::MAV_RESULT_UNSUPPORTED,
        })
    }

    fn arm_or_disarm(&mut self, command: &Command) -> MavResult {
        if command.param(1) == 1.0 {
            result(self.flight.arm(self.now_us, command.param(2) == FORCE))
        } else if command.param(1) == 0.0 {
            result(self.flight.disarm(command.param(2) == FORCE))
        } else {
            MavResult::MAV_RESULT_DENIED
        }
    }

    pub(super) fn set_mode(&mut self, custom: bool, mode: Option<Mode>) -> MavResult {
        match mode {
            Some(mode) if custom => result(self.flight.request_mode(self.now_us, mode)),
            _ => {
                let text = self.flight.personality.unknown_mode_text();
                self.flight.commander.notify(MavSeverity::MAV_SEVERITY_WARNING, text);
                MavResult::MAV_RESULT_DENIED
            }
        }
    }

    fn set_interval(&mut self, sender: Sender, command: &Command) -> MavResult {
        let schedule = &mut self.links[sender.link].schedule;
        match schedule.set_interval(command.param(1) as u32, command.param(2), self.now_us) {
            Ok(()) => MavResult::MAV_RESULT_ACCEPTED,
            Err(error) => self.flight.personality.refused_interval(error),
        }
    }

    fn request_message(&mut self, sender: Sender, command: &Command) -> MavResult {
        let personality = self.flight.personality;
        let stream = Stream::from_id(command.param(1) as u32);
        match stream.filter(|stream| personality.streams().has(*stream)) {
            Some(Stream::AvailableModes) => {
                // Index 0 requests all modes.
                let indices = match command.param(2) as usize {
                    0 => 1..=personality.modes().len(),
                    index => index..=index,
                };
                let mut result = MavResult::MAV_RESULT_DENIED;
                let messages =
                    indices.filter_map(|index| identity::available_mode(personality, index));
                for message in messages {
                    self.reply(sender, &message);
                    result = MavResult::MAV_RESULT_ACCEPTED;
                }
                result
            }
            Some(stream) => self.send_once(sender, stream),
            None => MavResult::MAV_RESULT_DENIED,
        }
    }

    fn send_once(&mut self, to: Sender, stream: Stream) -> MavResult {
        let message = self.snapshot().message(stream);
        match message {
            Some(message) if self.links[to.link].can_carry(stream.id()) => {
                self.reply(to, &message);
                MavResult::MAV_RESULT_ACCEPTED
            }
            _ => MavResult::MAV_RESULT_DENIED,
        }
    }
}

fn result(outcome: Result<(), Refusal>) -> MavResult {
    match outcome {
        Ok(()) => MavResult::MAV_RESULT_ACCEPTED,
        Err(_) => MavResult::MAV_RESULT_TEMPORARILY_REJECTED,
    }
}
