//! `downwash signing`: makes keys, and sends them to vehicles.

use std::fs::{File, OpenOptions};
use std::io::{self, Read, Write};
use std::path::Path;
use std::time::Duration;

use anyhow::{Context, anyhow, bail};
use message::Inbound;
use wire::signing::{KEY_LEN, Key, Stamp};

use super::listen::{Listener, OTHERS_WAIT};
use super::signing_state::SigningState;
use super::{Exit, ExitContext, print_status, print_text};
use crate::cli::{ListenArgs, SetupArgs, SigningCommand};
use crate::config::SIGNING_KEY_VARIABLE;
use crate::link::session::Delivery;
use crate::link::signing::{Ledger, Remembered, SigningSettings};

/// Wait for a vehicle, and for its reaction to a setup.
const SEARCH: Duration = Duration::from_secs(10);
const STEP: Duration = Duration::from_millis(100);
/// Number of times that the message is sent, because the vehicle acknowledges none.
const REPEATS: usize = 2;

pub(super) fn run(command: &SigningCommand) -> anyhow::Result<Exit> {
    match command {
        SigningCommand::Key { file } => key(file),
        SigningCommand::Setup(args) => setup(args),
    }
}

fn key(path: &Path) -> anyhow::Result<Exit> {
    let mut bytes = [0; KEY_LEN];
    File::open("/dev/urandom")
        .and_then(|mut random| random.read_exact(&mut bytes))
        .context("cannot read random numbers from /dev/urandom")?;
    let key = Key::new(bytes);
    write_key(path, &key)
        .with_context(|| format!("cannot write the key {}", path.display()))
        .or_exit(Exit::Usage)?;
    print_text(&format!("key {} in {}\n", key.fingerprint(), path.display()))?;
    Ok(Exit::Ok)
}

/// Writes a new file that only its owner can read.
pub(super) fn write_key(path: &Path, key: &Key) -> io::Result<()> {
    let mut options = OpenOptions::new();
    options.write(true).create_new(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    let mut file = options.open(path)?;
    writeln!(file, "{}", key.to_hex())?;
    file.sync_all()
}

fn setup(args: &SetupArgs) -> anyhow::Result<Exit> {
    let listen = ListenArgs {
        connect: args.connect.clone(),
        system: args.system,
        seconds: None,
        config: args.config.clone(),
        json: false,
    };
    let config = Listener::config(&listen)?;
    let state = SigningState::open(&config.settings.link.signing)?;
    let state = state
        .ok_or_else(|| {
            anyhow!(
                "there is no key for the vehicle: set link.signing.key_file, or \
                 ${SIGNING_KEY_VARIABLE}; make one with: downwash signing key FILE"
            )
        })
        .or_exit(Exit::Usage)?;
    let new = state.settings();
    let present = match (&args.old_key, args.off) {
        (Some(path), _) => {
            let key = Key::load(path).or_exit(Exit::Usage)?;
            let (before, ledger) = (Remembered::default(), Ledger::default());
            Some(SigningSettings { key, before, ledger, ..new.clone() })
        }
        (None, true) => Some(new.clone()),
        (None, false) => None,
    };
    let mut listener = Listener::signed(&listen, false, present)?;
    let mut is_armed = None;
    wait(&mut listener, |_, armed| {
        is_armed = armed.or(is_armed);
        is_armed.is_some()
    })?;
    if listener.session.requested_system().is_none() {
        listener.listen(OTHERS_WAIT, |_, delivery| {
            is_armed = armed_in(&delivery).or(is_armed);
        });
    }
    // No other vehicle gets the key.
    listener.check_alone()?;
    let id = listener.session.vehicle().context("no vehicle").or_exit(Exit::Link)?;
    if is_armed != Some(false) {
        let refused = || -> anyhow::Result<Exit> { bail!("{id} is armed; disarm it first") };
        return refused().or_exit(Exit::Refused);
    }
    for _ in 0..REPEATS {
        let now = listener.clock.now();
        let time = Stamp::from_unix_ns(now.as_ns()).max(new.before.newest);
        listener.session.set_up_signing((!args.off).then_some((&new.key, time)));
        listener.listen(STEP, |_, _| {});
    }
    // Another session, which accepts only frames under the new key.
    drop(listener);
    let fingerprint = new.key.fingerprint();
    let mut listener = Listener::signed(&listen, false, (!args.off).then_some(new))?;
    let is_as_requested = |listener: &Listener| listener.session.is_signed() != args.off;
    wait(&mut listener, |listener, _| {
        listener.session.vehicle().is_some() && is_as_requested(listener)
    })
    .context("the vehicle was sent the change of its key, and did not comply")?;
    let text = match args.off {
        true => format!("{id}: no longer signs, and accepts every sender\n"),
        false => format!("{id}: signs with the key {fingerprint}\n"),
    };
    print_text(&text)?;
    Ok(Exit::Ok)
}

/// Whether the vehicle is armed, by its HEARTBEAT.
fn armed_in(delivery: &Delivery<'_>) -> Option<bool> {
    match delivery {
        Delivery::Message(received) => match received.message {
            Inbound::Heartbeat { armed, .. } => Some(armed),
            _ => None,
        },
        _ => None,
    }
}

/// Listens until `is_done`, whose argument is whether the vehicle reports that it is armed.
fn wait(
    listener: &mut Listener,
    mut is_done: impl FnMut(&Listener, Option<bool>) -> bool,
) -> anyhow::Result<()> {
    print_status(format_args!("listening on {}", listener.endpoint));
    let started = listener.clock.now();
    while listener.clock.now().since(started) < SEARCH {
        let mut armed = None;
        listener.listen(STEP, |_, delivery| armed = armed_in(&delivery).or(armed));
        if is_done(listener, armed) {
            return Ok(());
        }
    }
    let failed = || -> anyhow::Result<()> { bail!("{}", listener.silence(listener.clock.now())) };
    failed().or_exit(Exit::Link)
}
