//! Reads ArduPilot logs (DataFlash, .bin) into flights.
//!
//! The file defines its messages and their units. Time stamps are on the vehicle's clock, in us
//! since boot (before ArduPilot 3.3 in ms).

mod ardupilot;
mod layout;
mod reader;

use std::collections::{BTreeMap, BTreeSet};
use std::io::Read;

use super::flight::Flight;
use super::onboard::{TopicSpec, Topics};
use super::statements::{Statement, Statements};
use super::tally::Tally;
use super::{LogFault, foreign};
use layout::{Access, Layout, Units};
pub(super) use reader::MARKS;
use reader::{MESSAGE_MAX, Message, Reader, Record};

/// The time stamp of a row, under the name that every row has here.
const STAMP: &str = "TimeUS";
/// Fewest messages by which a log without its start is recognised.
const MESSAGES_MIN: usize = 8;
/// Fields with the number of the sensor, core or pack.
const INSTANCES: [&str; 4] = ["I", "C", "Instance", "Inst"];

/// A message to read: its fields, and the SI value of each field's unit, for logs that do not
/// state units.
#[derive(Clone, Copy, Debug)]
struct Source {
    spec: TopicSpec,
    default_factors: &'static [f64],
    has_instances: bool,
}

/// Which sensor, core or pack a row is of.
#[derive(Clone, Copy, Debug)]
enum Instance {
    /// As a field of the row says.
    Field(Access),
    /// The same for all rows of the message.
    Only(u8),
}

/// A message whose rows are kept.
#[derive(Clone, Debug)]
struct Kept {
    source: Source,
    /// The time stamp and the value of its unit, s.
    stamp: (Access, f64),
    instance: Instance,
    /// The fields and the SI values of their units; `None` where the log lacks a field.
    fields: Vec<Option<(Access, f64)>>,
}

impl Kept {
    fn new(kind: u8, layout: &Layout, units: &Units) -> Option<Self> {
        let single = ardupilot::instance_of(&layout.name);
        let name = single.map_or(layout.name.as_str(), |(name, _)| name);
        let source = ardupilot::SOURCES.iter().find(|s| s.spec.topic == name)?;
        // Before ArduPilot 3.3 in ms.
        let stamp = match layout.field(&["TimeUS"]) {
            Some(field) => (field, 1e-6),
            None => (layout.field(&["TimeMS"])?, 1e-3),
        };
        let named = source.spec.fields.iter().zip(source.default_factors);
        let found = |(name, default_factor): (&&'static str, &f64)| {
            if *name == STAMP {
                return Some(stamp);
            }
            let access = layout.field(&ardupilot::names(name))?;
            let default_factor = ardupilot::older_unit(layout, access).unwrap_or(*default_factor);
            Some((access, units.factor(kind, access, default_factor)))
        };
        let field = layout.field(&INSTANCES).filter(|_| source.has_instances && single.is_none());
        let only = Instance::Only(single.map_or(0, |(_, instance)| instance));
        let instance = field.map_or(only, Instance::Field);
        Some(Self { source: *source, stamp, instance, fields: named.map(found).collect() })
    }
}

/// The content of a file before conversion to a flight.
#[derive(Debug, Default)]
struct Contents {
    topics: Topics,
    /// What the chosen boot states.
    stated: Statements,
    /// Notes on the boots.
    notes: Vec<String>,
    units: Units,
    tally: Tally,
}

/// Whether bytes begin as DataFlash logs do, with the definition of the message FMT.
pub(super) fn begins(head: &[u8]) -> bool {
    head.strip_prefix(&MARKS)
        .is_some_and(|rest| rest.first().is_none_or(|kind| *kind == layout::FMT))
}

/// Whether bytes look like a DataFlash log whose start is lost: most of the bytes between the first
/// and the last marks belong to messages, none longer than a message can be.
pub(super) fn has_messages(head: &[u8]) -> bool {
    let pairs = head.windows(MARKS.len()).enumerate();
    let starts: Vec<usize> =
        pairs.filter(|(_, pair)| **pair == MARKS).map(|(start, _)| start).collect();
    let (Some(first), Some(last)) = (starts.first(), starts.last()) else { return false };
    let lengths = starts.windows(2).map(|pair| pair[1] - pair[0]);
    let in_messages: usize = lengths.filter(|length| *length <= MESSAGE_MAX).sum();
    starts.len() >= MESSAGES_MIN && 2 * in_messages > last - first
}

/// Reads a whole log into `flight`. Returns its messages.
///
/// # Errors
/// Errors of `source`, the log of another program, or the log does not have the chosen boot.
/// Damage within the file is counted and is not an error.
pub(super) fn read(
    source: impl Read,
    boot: Option<usize>,
    flight: &mut Flight,
) -> Result<super::Contents, LogFault> {
    let mut reader = Reader::new(source);
    let mut contents = Contents::default();
    let mut kept: BTreeMap<u8, Option<Kept>> = BTreeMap::new();
    let mut names = BTreeSet::new();
    let mut values = Vec::new();
    // What the boots state: the number of rows before it, its stamp in s, and the statement.
    let mut statements: Vec<(usize, Option<f64>, Statement)> = Vec::new();
    while let Some(record) = reader.next()? {
        let message = match record {
            Record::Message(message) => message,
            Record::Redefined(kind) => {
                kept.remove(&kind);
                contents.units.forget_fields(kind);
                continue;
            }
        };
        let Message { kind, layout, body } = &message;
        let units = &contents.units;
        let fresh = kept.entry(*kind).or_insert_with(|| {
            let has_stamp = layout.field(&[STAMP, "TimeMS"]).is_some();
            let mark = if has_stamp { "" } else { " (without a time)" };
            names.insert(format!("{}{mark}", layout.name));
            Kept::new(*kind, layout, units)
        });
        let Some(kept) = fresh else {
            if let Some(statement) = statement(&message) {
                statements.push((contents.topics.len(), stamp(&message), statement));
            } else if let Some(kind) = contents.add_definition(&message) {
                kept.remove(&kind);
            }
            continue;
        };
        let number = |access: Access| access.number(body).unwrap_or(f64::NAN);
        let (stamp, seconds) = kept.stamp;
        let instance = match kept.instance {
            Instance::Field(field) => number(field) as u8,
            Instance::Only(instance) => instance,
        };
        values.clear();
        values.extend(
            kept.fields
                .iter()
                .map(|field| field.map_or(f64::NAN, |(access, factor)| number(access) * factor)),
        );
        contents.topics.push(kept.source.spec, instance, number(stamp) * seconds, &values);
    }
    let damage = reader.damage;
    if reader.messages == 0 {
        let found = match damage.undefined {
            0 => "no complete message of a DataFlash log",
            _ => foreign::NO_DEFINITIONS,
        };
        return Err(LogFault::Foreign(found.into()));
    }
    if reader.defines("TIME", "StartTime") {
        return Err(LogFault::Foreign(foreign::SDLOG2.into()));
    }
    contents.tally.add("byte that belongs to no whole message", damage.bytes);
    contents.tally.add("damaged definition of a message", damage.definitions);
    contents.tally.add("message without a definition (FMT) before it", damage.undefined);
    if damage.undefined > 0 && damage.first == Some(0) {
        contents
            .tally
            .lose("it does not begin with its definitions (FMT): its start is lost".into());
    }
    if damage.bytes > 0 {
        contents.tally.lose(match (damage.cut, damage.first) {
            (Some(cut), Some(first)) if cut == first => {
                format!("it ends within a message, at byte {cut}: it was cut short there")
            }
            (_, first) => format!(
                "{} bytes belong to no message, the first at byte {}",
                damage.bytes,
                first.unwrap_or(0)
            ),
        });
    }
    let topics = std::mem::take(&mut contents.topics);
    let (notes, tally) = (&mut contents.notes, &mut contents.tally);
    contents.topics = topics.choose_boot(boot, ardupilot::flown, notes, tally)?;
    let boots = &contents.topics.boots;
    let mut stated = vec![Statements::default(); boots.count()];
    for (row, stamp, statement) in statements {
        if let Some(boot) = stated.get_mut(boots.of(row, stamp)) {
            boot.add(statement);
        }
    }
    contents.stated = Statements::of_boot(&stated, boots.chosen, ardupilot::kinds);
    contents.fill(flight);
    let names = names.into_iter().collect();
    Ok(super::Contents { part: "message", names, reason: None })
}

/// The time stamp of a message, s.
fn stamp(Message { layout, body, .. }: &Message<'_>) -> Option<f64> {
    let number = |name: &str| layout.field(&[name]).and_then(|f| f.number(body));
    number(STAMP).map(|us| us * 1e-6).or(number("TimeMS").map(|ms| ms * 1e-3))
}

/// A parameter, a text, or the build.
fn statement(message: &Message<'_>) -> Option<Statement> {
    let Message { layout, body, .. } = message;
    let number = |name: &str| layout.field(&[name]).and_then(|f| f.number(body));
    let text = |name: &str| layout.field(&[name]).and_then(|f| f.text(body));
    match layout.name.as_str() {
        "PARM" => Some(Statement::Parameter(text("Name")?.to_owned(), number("Value")?)),
        "MSG" => {
            let time = stamp(message).map(|s| format!("{s:.3} s: ")).unwrap_or_default();
            Some(Statement::Text(None, time + text("Message")?))
        }
        "VER" => Some(Statement::Type(number("BU")? as u8)),
        _ => None,
    }
}

impl Contents {
    /// Stores the units of other messages. Returns the type of the messages whose units it states.
    fn add_definition(&mut self, message: &Message<'_>) -> Option<u8> {
        let Message { layout, body, .. } = message;
        let number = |name: &str| layout.field(&[name]).and_then(|f| f.number(body));
        let text = |name: &str| layout.field(&[name]).and_then(|f| f.text(body));
        match layout.name.as_str() {
            "UNIT" => {
                if let (Some(id), Some(label)) = (number("Id"), text("Label")) {
                    self.units.add_label(id, label);
                }
            }
            "MULT" => {
                if let (Some(id), Some(multiplier)) = (number("Id"), number("Mult")) {
                    self.units.add_multiplier(id, multiplier);
                }
            }
            "FMTU" => {
                let ids = (text("UnitIds"), text("MultIds"));
                if let (Some(kind), (Some(units), Some(multipliers))) = (number("FmtType"), ids) {
                    self.units.add_fields(kind, units, multipliers);
                    return Some(kind as u8);
                }
            }
            _ => {}
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A message, and the definition of one.
    fn message(kind: u8, body: &[u8]) -> Vec<u8> {
        [&MARKS[..], &[kind], body].concat()
    }

    fn definition(kind: u8, length: u8, name: &str, format: &str, columns: &str) -> Vec<u8> {
        let mut body = vec![kind, 3 + length];
        for (text, size) in [(name, 4), (format, 16), (columns, 64)] {
            let mut bytes = text.as_bytes().to_vec();
            bytes.resize(size, 0);
            body.extend(bytes);
        }
        message(layout::FMT, &body)
    }

    fn imported(bytes: &[u8]) -> Flight {
        let mut flight = Flight::in_memory("memory", "dataflash");
        assert!(read(bytes, None, &mut flight).is_ok());
        flight
    }

    /// A boot from `from_s` on, with rows of RCOU that have the motors on four outputs from `first`.
    fn boot(from_s: u64, seconds: u64, first: u8, firmware: &str, parameters: &str) -> Vec<u8> {
        let padded = |text: &str, size: usize| {
            let mut bytes = text.as_bytes().to_vec();
            bytes.resize(size, 0);
            bytes
        };
        let us = |ms: u64| ((1000 * from_s + ms) * 1000).to_le_bytes();
        let mut log = definition(2, 28, "PARM", "QNf", "TimeUS,Name,Value");
        log.extend(definition(3, 72, "MSG", "QZ", "TimeUS,Message"));
        log.extend(definition(13, 24, "RCOU", "QHHHHHHHH", "TimeUS,C1,C2,C3,C4,C5,C6,C7,C8"));
        let mut state = |name: &str, value: f32| {
            let body = [&us(0)[..], &padded(name, 16), &value.to_le_bytes()].concat();
            log.extend(message(2, &body));
        };
        (0..4).for_each(|n| state(&format!("SERVO{}_FUNCTION", first + n), 33.0 + f32::from(n)));
        parameters.split_whitespace().for_each(|name| state(name, 1.0));
        log.extend(message(3, &[&us(0)[..], &padded(firmware, 64)].concat()));
        for step in 0..50 * seconds {
            let pulse = |output: u8| {
                let is_motor = (first..first + 4).contains(&output);
                if is_motor { 1500 + (step % 50) as u16 } else { 900 }
            };
            let pulses: Vec<u8> = (1..=8).flat_map(|n| pulse(n).to_le_bytes()).collect();
            log.extend(message(13, &[&us(20 * step + 20)[..], &pulses].concat()));
        }
        log
    }

    #[test]
    fn facts_are_those_of_the_boot_that_is_read() {
        let quad = boot(4, 20, 5, "ArduCopter V4.5.0", "FRAME_CLASS");
        let bench = boot(2, 5, 1, "ArduCopter V4.4.0", "FRAME_CLASS");
        let plane = boot(3, 5, 1, "ArduPlane V4.5.0", "Q_ENABLE TECS_CLMB_MAX");
        for other in [bench, plane] {
            for log in [[&quad[..], &other].concat(), [&other[..], &quad].concat()] {
                let flight = imported(&log);
                assert_eq!(flight.outputs.len(), 1000);
                assert_eq!(flight.outputs.values()[7], [1507.0; 4]);
                assert_eq!(flight.facts.autopilot.as_deref(), Some("ArduCopter V4.5.0"));
                assert_eq!((flight.facts.stated_otherwise(), flight.facts.texts.len()), (None, 1));
            }
        }
    }

    #[test]
    fn messages_are_read_by_the_newest_definition() {
        let stamp = |step: u64| (1_000_000 + 10_000 * step).to_le_bytes();
        let mut log = definition(10, 16, "BAT", "Qff", "TimeUS,Volt,Curr");
        log.extend(definition(11, 20, "IMU", "Qfff", "TimeUS,GyrX,GyrY,GyrZ"));
        for step in 0..20 {
            log.extend(message(10, &[&stamp(step)[..], &12_f32.to_le_bytes(), &[0; 4]].concat()));
            log.extend(message(11, &[&stamp(step)[..], &[0; 12]].concat()));
        }
        // Another firmware: the types change places, and a field is new. The third is damaged.
        log.extend(definition(10, 20, "IMU", "Qfff", "TimeUS,GyrX,GyrY,GyrZ"));
        log.extend(definition(11, 16, "BAT", "Qff", "TimeUS,Res,Volt"));
        log.extend(definition(11, 16, "BAT", "Qff", "TimeUS,Volt"));
        for step in 20..40 {
            log.extend(message(10, &[&stamp(step)[..], &[0; 12]].concat()));
            log.extend(message(11, &[&stamp(step)[..], &[0; 4], &11_f32.to_le_bytes()].concat()));
        }
        let flight = imported(&log);
        assert_eq!(flight.body_rate.len(), 40);
        assert_eq!(flight.voltage.values(), [[12.0; 20], [11.0; 20]].concat());
        assert_eq!(flight.left_out, [("damaged definition of a message".to_owned(), 1)]);
    }

    #[test]
    fn log_without_its_start_is_recognised_by_the_marks_of_its_messages() {
        let message = [&MARKS[..], &[10; 30]].concat();
        assert!(has_messages(&message.repeat(20)[1..]));
        assert!(has_messages(&[vec![0; 5000], message.repeat(20)].concat()));
        assert!(!has_messages(&message.repeat(MESSAGES_MIN - 1)));
        // Marks far from each other are a coincidence.
        assert!(!has_messages(&[&MARKS[..], &[10; 5000]].concat().repeat(20)));
        assert!(!has_messages(&[]));
    }
}
