//! The terminal view: a flight on one screen, for a laptop over ssh.

use std::io::{IsTerminal, Stderr, stderr, stdin};
use std::sync::Once;
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

use super::screen_content::SharedContent;
use super::screen_layout::draw;
use super::stop::Stop;
use super::{Exit, ExitContext, status_line};
use crate::station::Status;

/// What a key requests.
enum KeyRequest {
    Stop,
    Scroll(isize),
    Nothing,
}

impl KeyRequest {
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

/// The screen. Dropping it restores the terminal and prints the messages there.
pub(super) struct Screen {
    terminal: Terminal<CrosstermBackend<Stderr>>,
    content: SharedContent,
    title: String,
}

impl Screen {
    /// Takes over the terminal.
    pub fn start(title: String) -> anyhow::Result<Self> {
        if !(stderr().is_terminal() && stdin().is_terminal()) {
            return Err(anyhow!(
                "--tui: expected a terminal on standard input and standard error; omit --tui where \
                 there is none"
            ))
            .or_exit(Exit::Usage);
        }
        restore_on_panic();
        let failed = "--tui: the terminal";
        enable_raw_mode().context(failed)?;
        let entered = execute!(stderr(), EnterAlternateScreen)
            .and_then(|()| Terminal::new(CrosstermBackend::new(stderr())));
        let terminal = entered.inspect_err(|_| restore()).context(failed)?;
        let content = SharedContent::default();
        status_line::print_on(Some(content.clone()));
        Ok(Self { terminal, content, title })
    }

    /// The screen's content, for sources of news.
    pub fn content(&self) -> SharedContent {
        self.content.clone()
    }

    /// Draws the status, and returns a request to stop by key. If the terminal is gone, the flight
    /// goes on.
    pub fn show(&mut self, status: &Status) -> Option<Stop> {
        let mut stop = None;
        while event::poll(Duration::ZERO).unwrap_or(false) {
            let Ok(event) = event::read() else { break };
            if let Event::Key(key) = event {
                match KeyRequest::of(key) {
                    KeyRequest::Stop => stop = Some(Stop::Interrupt),
                    KeyRequest::Scroll(by) => {
                        let mut content = self.content.lock();
                        let most = content.messages.len().saturating_sub(1);
                        content.scrolled = content.scrolled.saturating_add_signed(by).min(most);
                    }
                    KeyRequest::Nothing => {}
                }
            }
        }
        let content = self.content.lock().clone();
        let title = &self.title;
        let _ = self.terminal.draw(|frame| draw(frame, title, status, &content));
        stop
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        restore();
        status_line::print_on(None);
        for message in &self.content.lock().messages {
            super::print_status(format_args!("{message}"));
        }
    }
}

/// Restores the terminal; a second call does nothing.
fn restore() {
    if is_raw_mode_enabled().unwrap_or(false) {
        // In this order, so that raw mode is off by the time the normal screen is back.
        let _ = disable_raw_mode();
        let _ = execute!(stderr(), LeaveAlternateScreen, Show);
    }
}

/// Restores the terminal before a panic's message.
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
