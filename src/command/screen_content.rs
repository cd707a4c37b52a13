//! The content of the terminal view of a flight.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::log::record::{LinkStats, Record, Tick};
use crate::log::sink::Listener;

/// Number of kept messages, to scroll through and to print at the end.
const MESSAGES: usize = 500;

/// The content of the screen besides the status.
#[derive(Clone, Debug, Default)]
pub(super) struct ScreenContent {
    pub tick: Option<Tick>,
    pub link: Option<LinkStats>,
    /// Battery voltage, V.
    pub voltage: Option<f64>,
    /// Battery current, A.
    pub current: Option<f64>,
    pub messages: VecDeque<String>,
    /// Number of newest messages that are scrolled out of view.
    pub scrolled: usize,
}

/// The shared content of one flight's view. The log's thread and every source of messages write it.
#[derive(Clone, Debug, Default)]
pub(super) struct SharedContent(Arc<Mutex<ScreenContent>>);

impl SharedContent {
    pub fn lock(&self) -> MutexGuard<'_, ScreenContent> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Adds lines to the messages, without terminal sequences.
    pub fn print(&self, text: &[u8]) {
        let text = plain(&String::from_utf8_lossy(text));
        let mut content = self.lock();
        for line in text.lines().filter(|line| !line.trim().is_empty()) {
            if content.messages.len() == MESSAGES {
                content.messages.pop_front();
            }
            content.messages.push_back(line.to_owned());
            // While the user reads older messages, they keep their place until they are dropped.
            if content.scrolled > 0 {
                content.scrolled = (content.scrolled + 1).min(content.messages.len() - 1);
            }
        }
    }
}

impl Listener for SharedContent {
    fn on_record(&mut self, record: &Record) {
        match record {
            Record::Tick(tick) => self.lock().tick = Some(*tick),
            Record::Link { stats, .. } => self.lock().link = Some(*stats),
            Record::Battery { voltage, current, .. } => {
                let mut content = self.lock();
                (content.voltage, content.current) = (*voltage, *current);
            }
            _ => {}
        }
    }
}

/// The text without terminal sequences and control characters, so that none from a vehicle reaches
/// the terminal.
fn plain(text: &str) -> String {
    let mut plain = String::with_capacity(text.len());
    let mut rest = text.chars();
    while let Some(character) = rest.next() {
        if character == '\u{1b}' {
            // A control sequence ends at a character from @ to ~; any other has two characters.
            if rest.clone().next() != Some('\n') && rest.next() == Some('[') {
                rest.find(|c| ('@'..='~').contains(c));
            }
        } else if character == '\n' || !character.is_control() {
            plain.push(character);
        }
    }
    plain
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn escape_sequences_in_messages_do_not_reach_the_terminal() {
        let text =
            "\u{1b}[2m 0.1s\u{1b}[0m \u{1b}[32m INFO\u{1b}[0m vehicle: \u{1b}[2J\u{7}hi\nthere";
        assert_eq!(plain(text), " 0.1s  INFO vehicle: hi\nthere");
        assert_eq!(plain("\u{1b}[5~42 ok\u{1b}\nnext"), "42 ok\nnext");
    }

    #[test]
    fn message_history_is_bounded_and_keeps_its_scroll_position() {
        let content = SharedContent::default();
        content.print(b"one\n\ntwo\n");
        content.lock().scrolled = 1;
        content.print(b"three\n");
        assert_eq!(content.lock().scrolled, 2);
        (0..2 * MESSAGES).for_each(|n| content.print(format!("{n}\n").as_bytes()));
        assert_eq!(content.lock().messages.len(), MESSAGES);
        assert_eq!(content.lock().messages.back().map(String::as_str), Some("999"));
        assert_eq!(content.lock().scrolled, MESSAGES - 1, "the oldest message is still in view");
    }
}
