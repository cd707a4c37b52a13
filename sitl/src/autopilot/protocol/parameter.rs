//! The parameter protocol: read, write and list.

use wire::dialect::*;

use super::{Protocol, Sender};
use crate::autopilot::parameters::{Parameters, SetError};

impl Protocol {
    pub(super) fn read_parameter(&mut self, sender: Sender, request: &PARAM_REQUEST_READ_DATA) {
        let index = match usize::try_from(request.param_index) {
            Ok(index) => Some(index),
            Err(_) => request.param_id.to_str().ok().and_then(|n| self.flight.parameters.find(n)),
        };
        let answer = index.and_then(|index| value_message(&self.flight.parameters, index));
        let error = || {
            let error = MavParamError::MAV_PARAM_ERROR_DOES_NOT_EXIST;
            error_message(sender, request.param_id, request.param_index, error)
        };
        let explains = self.flight.personality.explains_refused_parameters();
        if let Some(answer) = answer.or_else(|| explains.then(error)) {
            self.reply(sender, &answer);
        }
    }

    /// Sets a parameter and broadcasts the new value. A refusal goes to the sender only, with the
    /// present value.
    pub(super) fn set_parameter(&mut self, sender: Sender, request: &PARAM_SET_DATA) {
        let name = request.param_id.to_str().unwrap_or_default();
        match self.flight.set_parameter(name, request.param_value, request.param_type) {
            Ok(index) => {
                if let Some(message) = value_message(&self.flight.parameters, index) {
                    self.broadcast(&message);
                }
            }
            Err(error) => {
                let known = self.flight.parameters.find(name);
                let explains = self.flight.personality.explains_refused_parameters();
                let code = match error {
                    SetError::Unknown => MavParamError::MAV_PARAM_ERROR_DOES_NOT_EXIST,
                    SetError::Type => MavParamError::MAV_PARAM_ERROR_TYPE_MISMATCH,
                    SetError::Range { .. } => MavParamError::MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE,
                    SetError::ReadOnly => MavParamError::MAV_PARAM_ERROR_READ_ONLY,
                };
                if explains {
                    let severity = MavSeverity::MAV_SEVERITY_WARNING;
                    self.flight.commander.notify(severity, format!("{name} not set: {error}"));
                    self.reply(sender, &error_message(sender, request.param_id, -1, code));
                }
                let value = known.and_then(|i| value_message(&self.flight.parameters, i));
                if let Some(message) = value {
                    self.reply(sender, &message);
                }
            }
        }
    }
}

/// PARAM_VALUE of the parameter at `index`.
pub(super) fn value_message(parameters: &Parameters, index: usize) -> Option<MavMessage> {
    let (name, param_value, param_type) = parameters.at(index)?;
    Some(MavMessage::PARAM_VALUE(PARAM_VALUE_DATA {
        param_value,
        param_count: parameters.count() as u16,
        param_index: index as u16,
        param_id: name.into(),
        param_type,
    }))
}

fn error_message(
    to: Sender,
    param_id: mavlink::types::CharArray<16>,
    param_index: i16,
    error: MavParamError,
) -> MavMessage {
    MavMessage::PARAM_ERROR(PARAM_ERROR_DATA {
        param_index,
        target_system: to.system,
        target_component: to.component,
        param_id,
        error,
    })
}
