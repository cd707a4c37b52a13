//! Reads the messages of a DataFlash log in order and skips damage.
//!
//! Each message begins with two marks and its type, whose length the log defines. A message that
//! neither another message nor the end follows is damaged: its marks may belong to other data.

use std::io::{self, Read};

use super::super::read_ahead::read_ahead;
use super::layout::{FMT, FMT_LENGTH, HEAD, Layout};

/// The first two bytes of every message.
pub(in crate::import) const MARKS: [u8; 2] = [0xA3, 0x95];
/// Length limit of a message: a definition has one byte for it.
pub(super) const MESSAGE_MAX: usize = u8::MAX as usize;
/// Bytes read at once.
const CHUNK: usize = 1 << 16;

/// Skipped data.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Damage {
    /// Number of bytes between messages.
    pub bytes: u64,
    /// Number of definitions that contradict themselves.
    pub definitions: u64,
    /// Number of messages whose type no earlier message defines.
    pub undefined: u64,
    /// Offset of the first skipped byte.
    pub first: Option<u64>,
    /// Offset of a message cut off by the end of the file.
    pub cut: Option<u64>,
}

/// A message without its header.
#[derive(Debug)]
pub(super) struct Message<'a> {
    pub kind: u8,
    pub layout: &'a Layout,
    pub body: &'a [u8],
}

/// What [`Reader::next`] returns.
#[derive(Debug)]
pub(super) enum Record<'a> {
    Message(Message<'a>),
    /// From here on, messages of this type have another layout.
    Redefined(u8),
}

/// Reads messages.
pub(super) struct Reader<R> {
    source: R,
    buffer: Vec<u8>,
    start: usize,
    /// Bytes of the source before the buffer.
    before: u64,
    ended: bool,
    layouts: Vec<Option<Layout>>,
    /// Number of valid messages so far.
    pub messages: u64,
    pub damage: Damage,
}

impl<R: Read> Reader<R> {
    pub fn new(source: R) -> Self {
        let layouts = std::iter::repeat_with(|| None).take(usize::from(u8::MAX) + 1).collect();
        Self {
            source,
            buffer: Vec::new(),
            start: 0,
            before: 0,
            ended: false,
            layouts,
            messages: 0,
            damage: Damage::default(),
        }
    }

    /// Whether a message of this name and with this field is defined.
    pub fn defines(&self, name: &str, field: &str) -> bool {
        let mut layouts = self.layouts.iter().flatten();
        layouts.any(|layout| layout.name == name && layout.field(&[field]).is_some())
    }

    /// Returns the next message that is not a definition, the next change of a layout, or `None` at
    /// the end.
    ///
    /// # Errors
    /// Errors of the source.
    pub fn next(&mut self) -> io::Result<Option<Record<'_>>> {
        let (kind, from, to) = loop {
            self.fill(2 * MESSAGE_MAX)?;
            let rest = &self.buffer[self.start..];
            if rest.is_empty() {
                return Ok(None);
            }
            let Some(length) = self.length(rest).filter(|length| self.continues(rest, *length))
            else {
                // The next message begins at its first mark at the earliest.
                let next = rest[1..].iter().position(|byte| *byte == MARKS[0]);
                let passed = 1 + next.unwrap_or(rest.len() - 1);
                let at = self.before + self.start as u64;
                if self.damage.cut.is_none()
                    && self.length(rest).is_some_and(|length| self.ended && length > rest.len())
                {
                    self.damage.cut = Some(at);
                }
                let is_undefined =
                    rest.len() >= HEAD && rest.starts_with(&MARKS) && self.length(rest).is_none();
                self.damage.undefined += u64::from(is_undefined);
                self.damage.first.get_or_insert(at);
                self.damage.bytes += passed as u64;
                self.start += passed;
                continue;
            };
            let kind = rest[2];
            let (from, to) = (self.start + HEAD, self.start + length);
            self.start += length;
            self.messages += 1;
            if kind != FMT {
                break (kind, from, to);
            }
            if let Some(redefined) = self.define(from, to) {
                return Ok(Some(Record::Redefined(redefined)));
            }
        };
        let layout = self.layouts[usize::from(kind)].as_ref();
        let body = &self.buffer[from..to];
        Ok(layout.map(|layout| Record::Message(Message { kind, layout, body })))
    }

    /// Stores a definition, if it is whole and does not contradict itself. Returns the type whose
    /// layout it changes: loggers repeat the definitions from time to time, and a file may continue
    /// with the log of another firmware.
    fn define(&mut self, from: usize, to: usize) -> Option<u8> {
        let Some((kind, layout)) = Layout::parse(&self.buffer[from..to]) else {
            self.damage.definitions += 1;
            return None;
        };
        let known = self.layouts[usize::from(kind)].replace(layout)?;
        (self.layouts[usize::from(kind)].as_ref() != Some(&known)).then_some(kind)
    }

    /// Length of the message at the start of `bytes`, if its type is defined.
    fn length(&self, bytes: &[u8]) -> Option<usize> {
        let kind = *bytes.strip_prefix(&MARKS)?.first()?;
        match kind {
            FMT => Some(FMT_LENGTH),
            kind => self.layouts[usize::from(kind)].as_ref().map(|layout| layout.length),
        }
    }

    /// Whether another message or the end follows a message of this length.
    fn continues(&self, bytes: &[u8], length: usize) -> bool {
        match bytes.get(length..) {
            None => false,
            Some([]) => true,
            // The file may end within the next header.
            Some(next) => MARKS.starts_with(&next[..next.len().min(2)]),
        }
    }

    fn fill(&mut self, needed: usize) -> io::Result<()> {
        if self.buffer.len() - self.start >= needed || self.ended {
            return Ok(());
        }
        self.buffer.drain(..self.start);
        self.before += self.start as u64;
        self.start = 0;
        self.ended = read_ahead(&mut self.source, &mut self.buffer, CHUNK)?;
        Ok(())
    }
}
