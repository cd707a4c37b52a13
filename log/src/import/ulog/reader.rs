//! Reads the messages of a ULog file in order and skips damage.
//!
//! A message consists of its length, type and bytes; nothing else marks its start. The reader
//! checks each message against the file's definitions: a row must have a known topic and the right
//! length. After a mismatch, it continues at the next position where two consecutive messages are
//! valid.

use std::collections::{BTreeMap, VecDeque};
use std::io::{self, Read};

use super::super::read_ahead::read_ahead;
use super::format::{Formats, Layout, is_name};

/// Magic bytes; the version follows.
pub(in crate::import) const MAGIC: [u8; 7] = [b'U', b'L', b'o', b'g', 0x01, 0x12, 0x35];
/// Length of magic, version and time stamp.
const FILE_HEAD: usize = 16;
/// Length of a message's header: size and type.
const HEAD: usize = 3;
/// Length limit of a message.
const MESSAGE_MAX: usize = HEAD + u16::MAX as usize;
/// Bytes searched at once for the next valid message.
const SEARCH: usize = 1 << 16;
/// Content of a sync message, which serves to resume after damage.
const SYNC: [u8; 8] = [0x2F, 0x73, 0x13, 0x20, 0x25, 0x0C, 0xBB, 0x12];
/// Incompatible flag for data appended after a crash.
const APPENDED: u8 = 1;

/// Why a file cannot be read at all.
#[derive(Debug)]
pub(in crate::import) enum UlogError {
    Io(io::Error),
    /// The file is not a ULog, or has flags that forbid reading it; the text says which.
    Foreign(String),
}

impl From<io::Error> for UlogError {
    fn from(error: io::Error) -> Self {
        Self::Io(error)
    }
}

/// A decoded message.
#[derive(Debug)]
pub(super) enum Record<'a> {
    /// `key`, such as `char[10] sys_name`, and the bytes of its value.
    Info {
        key: &'a str,
        value: &'a [u8],
    },
    Parameter {
        name: &'a str,
        value: f64,
    },
    /// A row of the topic with this number.
    Row {
        number: u16,
        topic: &'a Subscription,
        bytes: &'a [u8],
    },
    /// The logger dropped data for this time in ms.
    Dropout {
        ms: u16,
    },
    /// Text for people: level `0` (worst) to `7`, time stamp in us.
    Text {
        level: u8,
        time_us: u64,
        text: &'a str,
    },
    /// A definition, or a message that is not needed.
    Other,
}

/// A topic with logged rows.
#[derive(Clone, Debug)]
pub(super) struct Subscription {
    pub name: String,
    pub instance: u8,
    /// `None` if the file lacks its format.
    pub layout: Option<Layout>,
}

/// Skipped data.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Damage {
    /// Number of bytes between messages.
    pub bytes: u64,
    /// Number of whole messages that are invalid.
    pub messages: u64,
    /// Number of bytes of a message cut off by the end of the file.
    pub cut: u64,
    /// Offset of the first skipped data.
    pub first: Option<u64>,
}

/// Result of checking a position in the file.
enum Look {
    /// A valid message of this length, header included.
    Sound(usize),
    /// The header of a message of this length that is invalid.
    Odd(usize),
    /// The file ends before a whole message.
    Short,
}

/// Reads the messages of a ULog file.
pub(super) struct Reader<R> {
    source: R,
    buffer: Vec<u8>,
    /// Position of the next byte, in the buffer and in the file.
    start: usize,
    offset: u64,
    ended: bool,
    /// Whether the next position needs two consecutive valid messages.
    is_lost: bool,
    /// Offsets of appended data.
    appended: VecDeque<u64>,
    formats: Formats,
    subscriptions: BTreeMap<u16, Subscription>,
    pub damage: Damage,
}

impl<R: Read> Reader<R> {
    /// Reads the file header.
    ///
    /// # Errors
    /// Errors of `source`, or the file is not a ULog.
    pub fn new(source: R) -> Result<Self, UlogError> {
        let mut reader = Self {
            source,
            buffer: Vec::new(),
            start: 0,
            offset: 0,
            ended: false,
            is_lost: false,
            appended: VecDeque::new(),
            formats: Formats::default(),
            subscriptions: BTreeMap::new(),
            damage: Damage::default(),
        };
        reader.fill(FILE_HEAD)?;
        if !reader.rest().starts_with(&MAGIC) {
            return Err(UlogError::Foreign("no ULog header".into()));
        }
        if reader.rest().len() < FILE_HEAD {
            reader.damage.cut = reader.rest().len() as u64;
        }
        reader.advance(FILE_HEAD);
        Ok(reader)
    }

    /// Returns the next message, or `None` at the end.
    ///
    /// # Errors
    /// Errors of the source, or flags in the file that forbid reading it.
    pub fn next(&mut self) -> Result<Option<Record<'_>>, UlogError> {
        let length = loop {
            self.fill(2 * MESSAGE_MAX)?;
            if self.rest().is_empty() {
                return Ok(None);
            }
            if self.appended.front() == Some(&self.offset) {
                self.appended.pop_front();
                self.is_lost = false;
                continue;
            }
            let room = self.room();
            match self.look(0, room) {
                Look::Sound(length) if !self.is_lost || self.continues(length, room) => {
                    break length;
                }
                // A damaged length may point to a message far ahead; the data in between is not
                // lost.
                Look::Odd(length)
                    if !self.is_lost
                        && self.continues(length, room)
                        && self.next_sound(length, room).is_none() =>
                {
                    self.damage.messages += 1;
                    self.advance(length);
                }
                _ => self.search()?,
            }
        };
        self.is_lost = false;
        let kind = self.buffer[self.start + 2];
        let (from, to) = (self.start + HEAD, self.start + length);
        self.advance(length);
        self.take_in(kind, from, to)?;
        Ok(Some(self.record(kind, &self.buffer[from..to])))
    }

    fn record<'a>(&'a self, kind: u8, body: &'a [u8]) -> Record<'a> {
        let text = |bytes| std::str::from_utf8(bytes).unwrap_or("(text that is not UTF-8)");
        match (kind, body) {
            (b'I', body) => match keyed(body) {
                Some((key, value)) => Record::Info { key, value },
                None => Record::Other,
            },
            (b'P', body) => parameter(body).unwrap_or(Record::Other),
            (b'D', [low, high, bytes @ ..]) => {
                let number = u16::from_le_bytes([*low, *high]);
                match self.subscriptions.get(&number) {
                    Some(topic) => Record::Row { number, topic, bytes },
                    None => Record::Other,
                }
            }
            (b'O', [low, high]) => Record::Dropout { ms: u16::from_le_bytes([*low, *high]) },
            (b'L', [level, rest @ ..]) => match rest.split_first_chunk() {
                Some((time, rest)) => Record::Text {
                    level: *level,
                    time_us: u64::from_le_bytes(*time),
                    text: text(rest),
                },
                None => Record::Other,
            },
            _ => Record::Other,
        }
    }

    /// Stores a message's definitions.
    fn take_in(&mut self, kind: u8, from: usize, to: usize) -> Result<(), UlogError> {
        let body = &self.buffer[from..to];
        match kind {
            b'F' => {
                let is_kept = std::str::from_utf8(body).is_ok_and(|text| self.formats.define(text));
                self.damage.messages += u64::from(!is_kept);
            }
            b'A' => {
                let Some(([instance, low, high], name)) = body.split_first_chunk() else {
                    return Ok(());
                };
                let name = String::from_utf8_lossy(name).into_owned();
                let number = u16::from_le_bytes([*low, *high]);
                if let Some(known) = self.subscriptions.get(&number) {
                    self.damage.messages += u64::from(known.name != name);
                } else {
                    let layout = self.formats.layout(&name);
                    let subscription = Subscription { name, instance: *instance, layout };
                    self.subscriptions.insert(number, subscription);
                }
            }
            b'B' => {
                let flag = |at: usize| body.get(at).copied().unwrap_or(0);
                let unknown =
                    (0..8).any(|at| flag(8 + at) & !(if at == 0 { APPENDED } else { 0 }) != 0);
                if unknown {
                    let found =
                        "a ULog of a newer kind, whose flags forbid reading it as an old one";
                    return Err(UlogError::Foreign(found.into()));
                }
                if flag(8) & APPENDED != 0 {
                    let offsets = body
                        .get(16..)
                        .unwrap_or_default()
                        .chunks_exact(8)
                        .filter_map(|chunk| chunk.first_chunk());
                    let ahead = |offset: &u64| *offset > self.offset;
                    let mut offsets: Vec<u64> =
                        offsets.map(|bytes| u64::from_le_bytes(*bytes)).filter(ahead).collect();
                    offsets.sort_unstable();
                    self.appended = offsets.into();
                }
            }
            _ => {}
        }
        Ok(())
    }

    fn rest(&self) -> &[u8] {
        &self.buffer[self.start..]
    }

    /// Number of buffered bytes before appended data.
    fn room(&self) -> usize {
        let before = self.appended.front().map_or(u64::MAX, |offset| offset - self.offset);
        usize::try_from(before).unwrap_or(usize::MAX).min(self.rest().len())
    }

    /// Fills the buffer to `needed` bytes or the end of the file.
    fn fill(&mut self, needed: usize) -> io::Result<()> {
        if self.rest().len() >= needed || self.ended {
            return Ok(());
        }
        self.buffer.drain(..self.start);
        self.start = 0;
        self.ended = read_ahead(&mut self.source, &mut self.buffer, needed.max(4 * MESSAGE_MAX))?;
        Ok(())
    }

    fn advance(&mut self, count: usize) {
        let count = count.min(self.rest().len());
        self.start += count;
        self.offset += count as u64;
    }

    /// Checks the position `at` bytes ahead; no message may extend beyond `room`.
    fn look(&self, at: usize, room: usize) -> Look {
        let rest = &self.rest()[..room];
        let Some(([low, high, kind], body)) =
            rest.get(at..).and_then(|rest| rest.split_first_chunk())
        else {
            return Look::Short;
        };
        let length = usize::from(u16::from_le_bytes([*low, *high]));
        match body.get(..length) {
            Some(body) if self.is_sound(*kind, body, self.offset + at as u64) => {
                Look::Sound(HEAD + length)
            }
            Some(_) => Look::Odd(HEAD + length),
            None => Look::Short,
        }
    }

    /// Whether a valid message or the end is `at` bytes ahead.
    fn continues(&self, at: usize, room: usize) -> bool {
        at == room || matches!(self.look(at, room), Look::Sound(_))
    }

    /// The next position, less than `within` bytes ahead, with two consecutive valid messages.
    fn next_sound(&self, within: usize, room: usize) -> Option<usize> {
        (1..room.min(within)).find(|at| match self.look(*at, room) {
            Look::Sound(length) => self.continues(at + length, room),
            _ => false,
        })
    }

    /// Whether a message's content is plausible for its type and its place in the file.
    fn is_sound(&self, kind: u8, body: &[u8], offset: u64) -> bool {
        match kind {
            b'D' => body.split_first_chunk().is_some_and(|(topic, row)| {
                let subscription = self.subscriptions.get(&u16::from_le_bytes(*topic));
                subscription.is_some_and(|known| {
                    known.layout.as_ref().is_none_or(|layout| layout.takes(row.len()))
                })
            }),
            b'S' => body == SYNC,
            b'O' => body.len() == 2,
            b'R' => body.len() == 2,
            // The flags are the first message. Elsewhere a damaged byte made one of another message.
            b'B' => body.len() >= 40 && offset == FILE_HEAD as u64,
            b'L' => body.len() >= 9 && body[0].is_ascii_digit(),
            b'C' => body.len() >= 11 && body[0].is_ascii_digit(),
            b'A' => {
                let name = body.get(3..).and_then(|name| std::str::from_utf8(name).ok());
                name.is_some_and(is_name)
            }
            b'F' => std::str::from_utf8(body).is_ok_and(|text| text.contains(':')),
            b'I' | b'P' => keyed(body).is_some(),
            b'M' | b'Q' => body.split_first().is_some_and(|(_, body)| keyed(body).is_some()),
            _ => false,
        }
    }

    /// Advances to the next position with two consecutive valid messages, or by the search range.
    fn search(&mut self) -> io::Result<()> {
        self.fill(SEARCH + 2 * MESSAGE_MAX)?;
        let room = self.room();
        let found = self.next_sound(SEARCH, room);
        let passed = found.unwrap_or(room.min(SEARCH));
        // A valid sequence that ends within a message was cut off there.
        let is_cut = found.is_none() && passed == room && !self.is_lost;
        let count = if is_cut { &mut self.damage.cut } else { &mut self.damage.bytes };
        *count += passed as u64;
        self.damage.first = self.damage.first.or(Some(self.offset));
        self.advance(passed);
        self.is_lost = true;
        Ok(())
    }
}

/// Splits a message into key and value.
fn keyed(body: &[u8]) -> Option<(&str, &[u8])> {
    let (length, rest) = body.split_first()?;
    let (key, value) = rest.split_at_checked(usize::from(*length))?;
    let key = std::str::from_utf8(key).ok()?;
    let (kind, name) = key.split_once(' ')?;
    let kind = kind.split_once('[').map_or(kind, |(kind, _)| kind);
    (is_name(kind) && is_name(name)).then_some((key, value))
}

fn parameter(body: &[u8]) -> Option<Record<'_>> {
    let (key, value) = keyed(body)?;
    let (kind, name) = key.split_once(' ')?;
    let value = match kind {
        "int32_t" => f64::from(i32::from_le_bytes(value.try_into().ok()?)),
        "float" => f64::from(f32::from_le_bytes(value.try_into().ok()?)),
        _ => return None,
    };
    Some(Record::Parameter { name, value })
}
