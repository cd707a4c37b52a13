//! The terminal view: a flight on one screen, for a laptop over ssh.

use std::io::{IsTerminal, Stderr, stderr, stdin};
use std::sync::{Arc, Mutex, MutexGuard, Once, PoisonError};
use std::time::Duration;

use anyhow::{Context, anyhow};
use ratatui::Terminal;
use ratatui::backend::CrosstermBackend;
use ratatui::crossterm::cursor::Show;
use ratatui::crossterm::event::{self, Event, KeyCode, KeyEvent, KeyEventKind, KeyModifiers};
use ratatui::crossterm::execute;
use ratatui::crossterm::terminal::{
    EnterAlternateScreen, LeaveAlternateScreen, disable_raw_mode, enable_raw_mode,
    is_raw_mode_enabled,
};

use super::screen_layout::{Seen, draw};
use super::stop::Stop;
use super::{Exit, ExitContext, status_line};
use crate::log::record::Record;
use crate::log::sink::Listener;
use crate::station::Status;

/// Messages that are kept, to scroll in and to print in the end.
const MESSAGES: usize = 500;

/// What is seen of one flight. The log's thread and whoever has a message write it.
#[derive(Clone, Debug, Default)]
pub(super) struct Scene(Arc<Mutex<Seen>>);

impl Scene {
    fn lock(&self) -> MutexGuard<'_, Seen> {
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
    fn hear(&mut self, record: &Record) {
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

/// What a key asks for.
enum Asked {
    Stop,
    Scroll(isize),
    Nothing,
}

impl Asked {
    fn of(key: KeyEvent) -> Self {
        let is_control = key.modifiers.contains(KeyModifiers::CONTROL);
        match key.code {
            _ if key.kind == KeyEventKind::Release => Self::Nothing,
            KeyCode::Char('c') if is_control => Self::Stop,
            KeyCode::Char('q') => Self::Stop,
            KeyCode::Up => Self::Scroll(1),
            KeyCode::Down => Self::Scroll(-1),
            KeyCode::PageUp => Self::Scroll(10),
            KeyCode::PageDown => Self::Scroll(-10),
            _ => Self::Nothing,
        }
    }
}

/// The screen, until it is dropped: then the terminal is as it was, and has the messages.
pub(super) struct Screen {
    terminal: Terminal<CrosstermBackend<Stderr>>,
    scene: Scene,
    title: String,
}

impl Screen {
    /// Takes the terminal.
    pub fn start(title: String) -> anyhow::Result<Self> {
        if !(stderr().is_terminal() && stdin().is_terminal()) {
            return Err(anyhow!(
                "--tui: expected a terminal on standard input and standard error; \
                 leave --tui out where there is none"
            ))
            .or_exit(Exit::Usage);
        }
        restore_on_panic();
        let failed = "--tui: the terminal";
        enable_raw_mode().context(failed)?;
        let entered = execute!(stderr(), EnterAlternateScreen)
            .and_then(|()| Terminal::new(CrosstermBackend::new(stderr())));
        let terminal = entered.inspect_err(|_| restore()).context(failed)?;
        let scene = Scene::default();
        status_line::print_on(Some(scene.clone()));
        Ok(Self { terminal, scene, title })
    }

    /// What the screen shows, for whoever has news.
    pub fn scene(&self) -> Scene {
        self.scene.clone()
    }

    /// Draws, and looks at the keys. A terminal that is gone shows nothing, and the flight goes on.
    pub fn show(&mut self, status: &Status) -> Option<Stop> {
        let mut stop = None;
        while event::poll(Duration::ZERO).unwrap_or(false) {
            let Ok(event) = event::read() else { break };
            if let Event::Key(key) = event {
                match Asked::of(key) {
                    Asked::Stop => stop = Some(Stop::Interrupt),
                    Asked::Scroll(by) => {
                        let mut seen = self.scene.lock();
                        let most = seen.messages.len().saturating_sub(1);
                        seen.scrolled = seen.scrolled.saturating_add_signed(by).min(most);
                    }
                    Asked::Nothing => {}
                }
            }
        }
        let seen = self.scene.lock().clone();
        let title = &self.title;
        let _ = self.terminal.draw(|frame| draw(frame, title, status, &seen));
        stop
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        restore();
        status_line::print_on(None);
        for message in &self.scene.lock().messages {
            super::say(format_args!("{message}"));
        }
    }
}

/// Gives the terminal back; a second call does nothing.
fn restore() {
    if is_raw_mode_enabled().unwrap_or(false) {
        // In this order: who sees the screen come back finds the terminal as it was.
        let _ = disable_raw_mode();
        let _ = execute!(stderr(), LeaveAlternateScreen, Show);
    }
}

/// So that what a panic says is said on the terminal as it was.
fn restore_on_panic() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        let before = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |panic| {
            restore();
            before(panic);
        }));
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_sequence_of_a_message_gets_to_the_terminal() {
        let text =
            "\u{1b}[2m 0.1s\u{1b}[0m \u{1b}[32m INFO\u{1b}[0m vehicle: \u{1b}[2J\u{7}hi\nthere";
        assert_eq!(without_colours(text), " 0.1s  INFO vehicle: hi\nthere");
    }

    #[test]
    fn messages_are_kept_up_to_a_number_and_stay_under_the_eye() {
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
