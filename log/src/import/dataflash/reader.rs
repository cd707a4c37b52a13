//! Messages of a DataFlash log, in their order, past any damage.
//!
//! Each message begins with two marks and its type, whose length the log has defined; what does
//! not is passed over. A message in whose place the next does not begin is damaged too, so that a
//! mark within other data is not taken for one.

use std::io::{self, Read};

use super::super::read_ahead::read_ahead;
use super::layout::{FMT, FMT_LENGTH, HEAD, Layout};

/// How every message begins.
pub(in crate::import) const MARKS: [u8; 2] = [0xA3, 0x95];
/// Longest message: its length is one byte.
const MESSAGE_MAX: usize = u8::MAX as usize;
/// Bytes that are read at once.
const CHUNK: usize = 1 << 16;

/// What was passed over.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Damage {
    /// Bytes that belong to no message.
    pub bytes: u64,
    /// Definitions that contradict themselves or an earlier one.
    pub definitions: u64,
    /// Where the first such byte is.
    pub first: Option<u64>,
    /// Where the message begins that the file ends within.
    pub cut: Option<u64>,
}

/// A message, without its head.
#[derive(Debug)]
pub(super) struct Message<'a> {
    pub kind: u8,
    pub layout: &'a Layout,
    pub body: &'a [u8],
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
    /// Messages that were sound so far.
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

    /// The next message of a defined type that is no definition; `None` at the end.
    ///
    /// # Errors
    /// Those of the source.
    pub fn next(&mut self) -> io::Result<Option<Message<'_>>> {
        let (kind, from, to) = loop {
            self.fill(2 * MESSAGE_MAX)?;
            let rest = &self.buffer[self.start..];
            if rest.is_empty() {
                return Ok(None);
            }
            let Some(length) = self.length(rest).filter(|length| self.continues(rest, *length))
            else {
                // The marks at the earliest, of the next message.
                let next = rest[1..].iter().position(|byte| *byte == MARKS[0]);
                let passed = 1 + next.unwrap_or(rest.len() - 1);
                let at = self.before + self.start as u64;
                if self.damage.cut.is_none()
                    && self.length(rest).is_some_and(|length| self.ended && length > rest.len())
                {
                    self.damage.cut = Some(at);
                }
                self.damage.first.get_or_insert(at);
                self.damage.bytes += passed as u64;
                self.start += passed;
                continue;
            };
            let kind = rest[2];
            let (from, to) = (self.start + HEAD, self.start + length);
            self.start += length;
            self.messages += 1;
            if kind == FMT {
                self.define(from, to);
            } else {
                break (kind, from, to);
            }
        };
        let layout = self.layouts[usize::from(kind)].as_ref();
        Ok(layout.map(|layout| Message { kind, layout, body: &self.buffer[from..to] }))
    }

    fn define(&mut self, from: usize, to: usize) {
        let Some((kind, layout)) = Layout::parse(&self.buffer[from..to]) else {
            self.damage.definitions += 1;
            return;
        };
        match &mut self.layouts[usize::from(kind)] {
            // Loggers define all types anew now and then.
            Some(known) => self.damage.definitions += u64::from(*known != layout),
            unknown => *unknown = Some(layout),
        }
    }

    /// Length of the message that begins with `bytes`, if one does.
    fn length(&self, bytes: &[u8]) -> Option<usize> {
        let kind = *bytes.strip_prefix(&MARKS)?.first()?;
        match kind {
            FMT => Some(FMT_LENGTH),
            kind => self.layouts[usize::from(kind)].as_ref().map(|layout| layout.length),
        }
    }

    /// Whether another message, or the end, follows one of this length.
    fn continues(&self, bytes: &[u8], length: usize) -> bool {
        match bytes.get(length..) {
            None => false,
            Some([]) => true,
            // The end may lie within the next one's head.
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
