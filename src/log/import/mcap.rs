//! The project's own flight logs (.mcap) into flights.

use std::io::Read;

use sitl::frame::{Attitude, Frd, Ned};
use wire::Frame;

use super::flight::{Flight, TruthSample};
use super::frames::Frames;
use super::tally::Tally;
use crate::log::reader::{LogReader, ReadError};
use crate::log::schema::{Flat, MavlinkFrameMessage, TruthMessage};

/// Reads the rest of `reader` into `flight`.
///
/// # Errors
/// [`ReadError::Io`].
pub(super) fn read(
    reader: &mut LogReader<impl Read>,
    flight: &mut Flight,
) -> Result<(), ReadError> {
    let mut frames = Frames::default();
    let mut tally = Tally::default();
    while let Some(message) = reader.next_message()? {
        match message.channel.schema.as_str() {
            MavlinkFrameMessage::NAME => {
                let frame = message.decode::<MavlinkFrameMessage>();
                match frame.as_ref().and_then(|message| Frame::parse(&message.frame)) {
                    Some(frame) => frames.add(Some(message.log_time.as_ns()), &frame),
                    None => tally.add("frame that is damaged or unknown to the dialect", 1),
                }
            }
            TruthMessage::NAME => {
                let sample = message.decode::<TruthMessage>().and_then(|t| truth(&t));
                let kept = sample.is_some_and(|(time, truth)| flight.truth.push(time, truth));
                tally.add("/sim/truth: not finite or out of order", u64::from(!kept));
            }
            _ => {}
        }
    }
    let ending = reader.ending();
    tally.add("damaged part of the file", ending.damaged);
    tally.add("end of the file (it was cut short)", u64::from(!ending.finished));
    frames.finish(flight);
    let vehicle = reader.attachments().iter().find(|a| a.name != "config.toml");
    flight.vehicle_file =
        vehicle.and_then(|attachment| String::from_utf8(attachment.data.clone()).ok());
    flight.left_out.extend(tally.into_vec());
    Ok(())
}

/// The true state, and when on the vehicle's clock.
fn truth(m: &TruthMessage) -> Option<(f64, TruthSample)> {
    let attitude = Attitude { w: m.q_w, x: m.q_x, y: m.q_y, z: m.q_z };
    let sample = TruthSample {
        position: Ned::new(m.p_n_m, m.p_e_m, m.p_d_m),
        velocity: Ned::new(m.v_n_mps, m.v_e_mps, m.v_d_mps),
        attitude,
        body_rate: Frd::new(m.p_radps, m.q_radps, m.r_radps),
        acceleration: Ned::new(m.a_n_mps2, m.a_e_mps2, m.a_d_mps2),
        angular_acceleration: Frd::new(m.alpha_x_radps2, m.alpha_y_radps2, m.alpha_z_radps2),
    };
    let world = [sample.position, sample.velocity, sample.acceleration];
    let body = [sample.body_rate, sample.angular_acceleration];
    let norm = attitude.w.hypot(attitude.x).hypot(attitude.y).hypot(attitude.z);
    let sound = world.iter().all(|v| v.is_finite())
        && body.iter().all(|v| v.is_finite())
        && (norm - 1.0).abs() < 0.01;
    sound.then_some((m.vehicle_time_us as f64 * 1e-6, sample))
}
