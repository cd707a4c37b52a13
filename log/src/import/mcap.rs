//! Reads downwash's logs (.mcap) into flights: logs of flights, which hold every raw frame, and
//! logs of imported flights, which hold flat channels.

use std::collections::BTreeSet;
use std::io::Read;

use wire::Frame;

use super::flat::{self, Taken};
use super::flight::Flight;
use super::frames::{Frames, UNREAD_FRAME};
use super::references::References;
use super::tally::Tally;
use super::{Choice, Contents, LogFault};
use crate::reader::{Channel, LogReader};
use crate::record::stated_parameter;
use crate::schema::{Flat, MavlinkFrameMessage};

/// Name of the attachment that is not the vehicle file.
const CONFIG: &str = "config.toml";
/// Largest number of foreign topics kept.
const TOPICS_MAX: usize = 64;

/// Reads the rest of `reader` into `flight`. Returns the foreign topics in the log.
///
/// # Errors
/// Errors of the source, or the log does not have the chosen vehicle or boot.
pub(super) fn read(
    reader: &mut LogReader<impl Read>,
    choice: Choice<'_>,
    flight: &mut Flight,
) -> Result<Contents, LogFault> {
    let mut frames: Option<Frames> = None;
    let mut references = References::default();
    let mut tally = Tally::default();
    let mut others = BTreeSet::new();
    while let Some(message) = reader.next_message()? {
        if message.channel.schema == MavlinkFrameMessage::NAME {
            let frame = message.decode::<MavlinkFrameMessage>();
            match frame.as_ref().and_then(|message| Frame::parse(&message.frame)) {
                Some(frame) => {
                    let frames = frames.get_or_insert_default();
                    frames.add(Some(message.log_time.as_ns()), &frame);
                }
                None => tally.add(UNREAD_FRAME, 1),
            }
        } else if references.take(&message, &mut flight.reference) {
            // One of the messages of a control tick.
        } else {
            let channel = &message.channel;
            match flat::take(&message, flight) {
                Taken::Kept => {}
                Taken::Refused => {
                    tally.add(&format!("{}: not finite or out of order", channel.topic), 1);
                }
                Taken::Other if others.len() < TOPICS_MAX => {
                    let Channel { topic, schema, message_encoding, .. } = &**channel;
                    let of = |text: &str, none: &str| match text {
                        "" => none.to_owned(),
                        text => text.to_owned(),
                    };
                    let schema = of(schema, "no schema");
                    let encoding = of(message_encoding, "no encoding that it names");
                    others.insert(format!("{topic} ({schema} in {encoding})"));
                }
                Taken::Other => {}
            }
        }
    }
    let ending = reader.ending();
    tally.add("damaged part of the file", ending.damaged);
    tally.add("end of the file (it was cut short)", u64::from(!ending.finished));
    if ending.damaged > 0 {
        tally.lose(format!("{} damaged parts were skipped", ending.damaged));
    }
    if !ending.finished {
        tally.lose("it has no end: it was cut short, or is still being written".to_owned());
    }
    if !flat::take_facts(reader.run(), flight)
        && let Some(frames) = frames
    {
        let facts = reader.run().iter();
        let stated = facts.filter_map(|(key, value)| stated_parameter(key, value));
        flight.facts.parameters = stated.collect();
        frames.finish(choice, flight)?;
    } else if let Some(boot) = choice.boot.filter(|boot| *boot != 1) {
        return Err(LogFault::NoBoot { boot, boots: 1 });
    } else if let Some(system) = choice.system {
        let found = "this log has one vehicle, without an id".to_owned();
        return Err(LogFault::NoSystem { system, found });
    }
    let vehicle = reader.attachments().iter().find(|attachment| attachment.name != CONFIG);
    flight.vehicle_file =
        vehicle.and_then(|attachment| String::from_utf8(attachment.data.clone()).ok());
    tally.give(flight);
    let names = others.into_iter().collect();
    Ok(Contents { part: "topic", names, reason: None })
}
