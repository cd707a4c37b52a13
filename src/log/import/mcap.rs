//! Own logs (.mcap) into flights: those of flights, which hold every raw frame, and those of
//! imported flights, which hold flat channels.

use std::io::Read;

use wire::Frame;

use super::flat::{self, Taken};
use super::flight::Flight;
use super::frames::Frames;
use super::references::References;
use super::tally::Tally;
use crate::log::reader::{LogReader, ReadError};
use crate::log::schema::{Flat, MavlinkFrameMessage};

/// Name of the attachment that is not the vehicle file.
const CONFIG: &str = "config.toml";

/// Reads the rest of `reader` into `flight`.
///
/// # Errors
/// [`ReadError::Io`].
pub(super) fn read(
    reader: &mut LogReader<impl Read>,
    flight: &mut Flight,
) -> Result<(), ReadError> {
    let mut frames: Option<Frames> = None;
    let mut references = References::default();
    let mut tally = Tally::default();
    while let Some(message) = reader.next_message()? {
        if message.channel.schema == MavlinkFrameMessage::NAME {
            let frame = message.decode::<MavlinkFrameMessage>();
            match frame.as_ref().and_then(|message| Frame::parse(&message.frame)) {
                Some(frame) => {
                    let frames = frames.get_or_insert_default();
                    frames.add(Some(message.log_time.as_ns()), &frame);
                }
                None => tally.add("frame that is damaged or unknown to the dialect", 1),
            }
        } else if references.take(&message, &mut flight.reference) {
            // One of the messages of a control tick.
        } else if flat::take(&message, flight) == Taken::Refused {
            let topic = &message.channel.topic;
            tally.add(&format!("{topic}: not finite or out of order"), 1);
        }
    }
    let ending = reader.ending();
    tally.add("damaged part of the file", ending.damaged);
    tally.add("end of the file (it was cut short)", u64::from(!ending.finished));
    if !flat::take_facts(reader.run(), flight)
        && let Some(frames) = frames
    {
        frames.finish(flight);
    }
    let vehicle = reader.attachments().iter().find(|attachment| attachment.name != CONFIG);
    flight.vehicle_file =
        vehicle.and_then(|attachment| String::from_utf8(attachment.data.clone()).ok());
    flight.left_out.extend(tally.into_vec());
    Ok(())
}
