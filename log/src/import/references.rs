//! The reference that the daemon tracked, from its messages of each control tick.

use message::setpoint::{Reference, Setpoint};
use vehicle::frame::{Euler, Frd, Ned};

use super::flight::Stream;
use crate::reader::Message;
use crate::schema::{ControlMessage, Flat, ReferenceMessage, SetpointMessage, StateMessage};

/// Assembles a tick from its messages, in the order state, reference, setpoint, control. The state
/// has the vehicle's time, the control message the feed-forward.
#[derive(Debug, Default)]
pub(super) struct References {
    time: f64,
    point: Option<ReferenceMessage>,
    was_sent: bool,
}

impl References {
    /// Processes a message of a tick; the last one adds the reference to `stream` if a setpoint was
    /// sent. Returns whether the message belongs to a tick.
    pub fn take(&mut self, message: &Message<'_>, stream: &mut Stream<Reference>) -> bool {
        match message.channel.schema.as_str() {
            StateMessage::NAME => {
                let state = message.decode::<StateMessage>();
                self.time = state.map_or(f64::NAN, |state| state.vehicle_time_us as f64 * 1e-6);
                (self.point, self.was_sent) = (None, false);
            }
            ReferenceMessage::NAME => self.point = message.decode(),
            SetpointMessage::NAME => self.was_sent = true,
            ControlMessage::NAME => {
                let point = self.point.take().filter(|_| std::mem::take(&mut self.was_sent));
                if let Some((point, control)) = point.zip(message.decode::<ControlMessage>()) {
                    let reference = reference(&point, &control);
                    if is_finite(&reference) {
                        stream.push(self.time, reference);
                    }
                }
            }
            _ => return false,
        }
        true
    }
}

fn reference(point: &ReferenceMessage, control: &ControlMessage) -> Reference {
    Reference {
        position: Ned::new(point.p_n_m, point.p_e_m, point.p_d_m),
        velocity: Ned::new(point.v_n_mps, point.v_e_mps, point.v_d_mps),
        attitude: Euler::new(point.roll_rad, point.pitch_rad, point.yaw_rad),
        body_rate: Frd::new(point.p_radps, point.q_radps, point.r_radps),
        feedforward: Setpoint {
            thrust_n: control.ff_thrust_n,
            attitude: Euler::new(control.ff_roll_rad, control.ff_pitch_rad, control.ff_yaw_rad),
            body_rate: Frd::new(control.ff_p_radps, control.ff_q_radps, control.ff_r_radps),
        },
    }
}

fn is_finite(reference: &Reference) -> bool {
    let Euler { roll, pitch, yaw } = reference.attitude;
    reference.position.is_finite()
        && reference.velocity.is_finite()
        && reference.body_rate.is_finite()
        && reference.feedforward.is_finite()
        && [roll, pitch, yaw].iter().all(|angle| angle.is_finite())
}
