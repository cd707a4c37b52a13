//! Reads PX4 logs (ULog) into flights.
//!
//! The file defines its topics, so fields are found by name in old and new logs. Time stamps are on
//! the vehicle's clock, in us since boot.

mod format;
mod px4;
mod reader;

use std::collections::{BTreeMap, BTreeSet};
use std::io::Read;

use super::LogFault;
use super::facts::Texts;
use super::flight::Flight;
use super::onboard::{TopicSpec, Topics};
use super::tally::Tally;
use format::Place;
pub(super) use reader::{MAGIC, UlogError};
use reader::{Reader, Record, Subscription};

/// Largest number of changes of parameters that are kept; a damaged log may have any number.
const CHANGES_MAX: usize = 1000;

/// The content of a file before conversion to a flight.
#[derive(Debug, Default)]
struct Contents {
    topics: Topics,
    /// Last value of each parameter.
    parameters: BTreeMap<String, f64>,
    /// Parameters that changed during the log.
    changed: BTreeMap<String, f64>,
    /// The same changes in the order of the log.
    changes: Vec<Change>,
    /// `sys_name` and others.
    info: BTreeMap<String, String>,
    texts: Texts,
    /// Notes on the boots.
    notes: Vec<String>,
    /// Topics with rows.
    names: BTreeSet<String>,
    tally: Tally,
}

/// A change of a parameter during the log.
#[derive(Debug)]
struct Change {
    name: String,
    /// Time of the last row before it, s.
    time: f64,
    /// The value until then.
    before: f64,
}

/// A topic whose rows are kept.
struct Kept {
    spec: TopicSpec,
    stamp: Place,
    places: Vec<Option<Place>>,
}

impl Kept {
    fn new(topic: &Subscription) -> Option<Self> {
        let spec = px4::TOPIC_SPECS.iter().find(|spec| spec.topic == topic.name)?;
        let layout = topic.layout.as_ref()?;
        let places = spec.fields.iter().map(|field| layout.place(field)).collect();
        Some(Self { spec: *spec, stamp: layout.place("timestamp")?, places })
    }
}

/// Reads a whole log into `flight`. Returns its topics.
///
/// # Errors
/// Those of [`UlogError`], or the log does not have the chosen boot. Damage within the file is
/// counted and is not an error.
pub(super) fn read(
    source: impl Read,
    boot: Option<usize>,
    flight: &mut Flight,
) -> Result<super::Contents, LogFault> {
    let mut contents = Contents::read(source)?;
    let names = std::mem::take(&mut contents.names).into_iter().collect();
    let topics = std::mem::take(&mut contents.topics);
    let (notes, tally) = (&mut contents.notes, &mut contents.tally);
    contents.topics = topics.choose_boot(boot, px4::flown, notes, tally)?;
    contents.fill(flight);
    Ok(super::Contents { part: "topic", names, reason: None })
}

impl Contents {
    fn read(source: impl Read) -> Result<Self, UlogError> {
        let mut reader = Reader::new(source)?;
        let mut contents = Self::default();
        let mut kept: BTreeMap<u16, Option<Kept>> = BTreeMap::new();
        let mut values = Vec::new();
        let (mut rows, mut dropouts, mut dropout_ms) = (0_u64, 0, 0_u64);
        while let Some(record) = reader.next()? {
            match record {
                Record::Row { number, topic, bytes } => {
                    rows += 1;
                    if topic.layout.is_none() {
                        let reason = format!("row of {}, whose format the file lacks", topic.name);
                        contents.tally.add(&reason, 1);
                    }
                    let kept = kept.entry(number).or_insert_with(|| {
                        contents.names.insert(topic.name.clone());
                        Kept::new(topic)
                    });
                    let Some(kept) = kept else { continue };
                    let read = |place: &Place| place.read(bytes).unwrap_or(f64::NAN);
                    values.clear();
                    values.extend(
                        kept.places.iter().map(|place| place.as_ref().map_or(f64::NAN, read)),
                    );
                    let time = read(&kept.stamp) * 1e-6;
                    contents.topics.push(kept.spec, topic.instance, time, &values);
                }
                Record::Parameter { name, value } => {
                    let before = contents.parameters.insert(name.to_owned(), value);
                    if let Some(before) = before.filter(|before| rows > 0 && *before != value) {
                        contents.changed.insert(name.to_owned(), value);
                        if contents.changes.len() < CHANGES_MAX {
                            let (name, time) = (name.to_owned(), contents.topics.latest());
                            contents.changes.push(Change { name, time, before });
                        }
                    }
                }
                Record::Info { key, value } => contents.add_info(key, value),
                Record::Text { level, time_us, text } => {
                    let time = time_us as f64 * 1e-6;
                    let text = format!("{time:.3} s: {}", text.trim());
                    contents.texts.add(Some(level.saturating_sub(b'0')), text);
                }
                Record::Dropout { ms } => {
                    dropouts += 1;
                    dropout_ms += u64::from(ms);
                }
                Record::Other => {}
            }
        }
        let damage = reader.damage;
        let tally = &mut contents.tally;
        tally.add("damaged byte between messages", damage.bytes);
        tally.add("damaged or contradictory message", damage.messages);
        tally.add("byte of a message that the file ends within (it was cut short)", damage.cut);
        if let Some(first) = damage.first {
            tally.lose(match damage.bytes {
                0 => format!("it ends within a message, at byte {first}: it was cut short there"),
                lost => format!("{lost} bytes belong to no message, the first at byte {first}"),
            });
        }
        if dropouts > 0 {
            let reason = format!("dropout of the logger, {:.3} s in all", dropout_ms as f64 * 1e-3);
            tally.add(&reason, dropouts);
        }
        Ok(contents)
    }

    /// The value of a parameter at a time.
    fn parameter_at(&self, name: &str, time: f64) -> Option<f64> {
        let mut later = self.changes.iter().filter(|c| c.name == name && c.time >= time);
        later.next().map(|change| change.before).or(self.parameters.get(name).copied())
    }

    fn add_info(&mut self, key: &str, value: &[u8]) {
        let Some((kind, name)) = key.split_once(' ') else { return };
        let text = match (kind, value) {
            ("uint32_t", [a, b, c, d]) => u32::from_le_bytes([*a, *b, *c, *d]).to_string(),
            ("int32_t", [a, b, c, d]) => i32::from_le_bytes([*a, *b, *c, *d]).to_string(),
            (kind, value) if kind.starts_with("char[") => {
                String::from_utf8_lossy(value).trim_end_matches('\0').to_owned()
            }
            _ => return,
        };
        self.info.insert(name.to_owned(), text);
    }
}
