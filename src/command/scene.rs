//! What the terminal view shows of a flight.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::log::record::{LinkStats, Record, Tick};
use crate::log::sink::Listener;

/// Messages that are kept, to scroll in and to print in the end.
const MESSAGES: usize = 500;

/// What the screen shows beside the status.
#[derive(Clone, Debug, Default)]
pub(super) struct Seen {
    pub tick: Option<Tick>,
    pub link: Option<LinkStats>,
    /// V and A.
    pub battery: (Option<f64>, Option<f64>),
    pub messages: VecDeque<String>,
    /// How many of the newest messages are scrolled past.
    pub scrolled: usize,
}

/// What is seen of one flight. The log's thread and whoever has a message write it.
#[derive(Clone, Debug, Default)]
pub(super) struct Scene(Arc<Mutex<Seen>>);

impl Scene {
    pub fn lock(&self) -> MutexGuard<'_, Seen> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Adds lines to the messages, without the colours that they may have.
    pub fn print(&self, text: &[u8]) {
        let text = without_colours(&String::from_utf8_lossy(text));
        let mut seen = self.lock();
        for line in text.lines().filter(|line| !line.trim().is_empty()) {
            if seen.messages.len() == MESSAGES {
                seen.messages.pop_front();
            }
            seen.messages.push_back(line.to_owned());
            // What is read stays where it is.
            if seen.scrolled > 0 {
                seen.scrolled += 1;
            }
        }
    }
}

impl Listener for Scene {
    fn on_record(&mut self, record: &Record) {
        match record {
            Record::Tick(tick) => self.lock().tick = Some(*tick),
            Record::Link { stats, .. } => self.lock().link = Some(*stats),
            Record::Battery { voltage, current, .. } => {
                self.lock().battery = (*voltage, *current);
            }
            _ => {}
        }
    }
}

/// The text without terminal sequences, so that none that a vehicle sends gets to the terminal.
fn without_colours(text: &str) -> String {
    let mut plain = String::with_capacity(text.len());
    let mut rest = text.chars();
    while let Some(character) = rest.next() {
        if character == '\u{1b}' {
            // To the letter that ends it.
            let mut sequence = rest.by_ref().skip_while(|c| *c == '[');
            sequence.find(|c| c.is_ascii_alphabetic());
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
        assert_eq!(without_colours(text), " 0.1s  INFO vehicle: hi\nthere");
    }

    #[test]
    fn message_history_is_bounded_and_keeps_its_scroll_position() {
        let scene = Scene::default();
        scene.print(b"one\n\ntwo\n");
        scene.lock().scrolled = 1;
        scene.print(b"three\n");
        assert_eq!(scene.lock().scrolled, 2);
        (0..2 * MESSAGES).for_each(|n| scene.print(format!("{n}\n").as_bytes()));
        assert_eq!(scene.lock().messages.len(), MESSAGES);
        assert_eq!(scene.lock().messages.back().map(String::as_str), Some("999"));
    }
}
