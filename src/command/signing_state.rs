//! The key of a signed link, and the file that keeps its stamps between runs.

use std::path::{Path, PathBuf};
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::thread::{self, JoinHandle};
use std::time::{Duration, SystemTime, UNIX_EPOCH};
use std::{fs, io};

use anyhow::{Context, anyhow, bail};
use mavlink::Message;
use serde::{Deserialize, Serialize};
use wire::dialect::MavMessage;
use wire::signing::{Key, Stamp, StreamId, StreamStamp};

use super::{Exit, ExitContext, print_status, write_file};
use crate::config::{SIGNING_KEY_VARIABLE, SigningSettings};
use crate::link::signing::{self, Ledger, Remembered};

/// Period at which the file is written.
const WRITE_PERIOD: Duration = Duration::from_secs(5);
/// Advance of the stamps after a run that may have sent more since it last wrote the file.
const UNWRITTEN: u64 = 10 * Stamp::PER_S;
/// Largest state file, bytes.
const FILE_LEN_MAX: u64 = 1 << 20;

/// The content of the state file.
#[derive(Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct StampsFile {
    schema: String,
    schema_version: u32,
    /// Identifies the key.
    key: String,
    newest: u64,
    streams: Vec<StreamRow>,
}

#[derive(Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct StreamRow {
    system: u32,
    component: u8,
    link: u8,
    newest: u64,
}

/// A key, and a thread that stores its stamps until this is dropped.
pub(super) struct SigningState {
    settings: signing::SigningSettings,
    stop: Option<Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl SigningState {
    /// The key that the settings or the environment name, if any. From here on its stamps are
    /// stored.
    ///
    /// # Errors
    /// The named key is missing, others may read its file, or the state file is invalid or belongs
    /// to another key.
    pub fn open(settings: &SigningSettings) -> anyhow::Result<Option<Self>> {
        Self::opened(settings, std::env::var_os(SIGNING_KEY_VARIABLE).as_deref())
            .context("link.signing")
            .or_exit(Exit::Usage)
    }

    fn opened(
        settings: &SigningSettings,
        variable: Option<&std::ffi::OsStr>,
    ) -> anyhow::Result<Option<Self>> {
        let SigningSettings { key_file, link_id, state_file, accept_unsigned, ahead_max_s } =
            settings;
        let key = match (key_file, variable) {
            (None, None) => return Ok(None),
            (Some(_), Some(_)) => bail!(
                "there are two keys, in key_file and in ${SIGNING_KEY_VARIABLE}; remove one of them"
            ),
            (Some(path), None) => Key::load(path)?,
            (None, Some(text)) => {
                let place = format!("${SIGNING_KEY_VARIABLE}");
                Key::parse(&text.to_string_lossy(), &place)?
            }
        };
        let beside = key_file.as_ref().map(|path| {
            let mut name = path.as_os_str().to_owned();
            name.push(".stamps");
            PathBuf::from(name)
        });
        let path = state_file.clone().or(beside).ok_or_else(|| {
            anyhow!(
                "a key from ${SIGNING_KEY_VARIABLE} needs state_file, which keeps the stamps that \
                 must not be reused"
            )
        })?;
        let before = read(&path, &key)?;
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let now = Stamp::from_unix_ns(now.as_nanos() as u64);
        let ahead_s = before.newest.seconds_since(now);
        if ahead_s > 3600.0 {
            print_status(format_args!(
                "the stamps in {} are {ahead_s:.0} s ahead of this computer's clock; check the clock",
                path.display()
            ));
        }
        let ahead_max = Duration::try_from_secs_f64(*ahead_max_s).context("ahead_max_s")?;
        let ledger = Ledger::default();
        let settings = signing::SigningSettings {
            key: key.clone(),
            link: *link_id,
            unsigned: ids(accept_unsigned)?,
            ahead_max,
            before: before.clone(),
            ledger: ledger.clone(),
        };
        // A state file that cannot be written is an error before a flight, not in it.
        write(&path, &key, &before)?;
        let (stop, stopped) = channel();
        let thread = thread::Builder::new().name("signing".into()).spawn(move || {
            let (mut written, mut is_reported) = (before, false);
            loop {
                let is_over = stopped.recv_timeout(WRITE_PERIOD) != Err(RecvTimeoutError::Timeout);
                let now = ledger.get();
                if now.newest > written.newest {
                    match write(&path, &key, &now) {
                        Ok(()) => (written, is_reported) = (now, false),
                        Err(error) if !is_reported => {
                            tracing::warn!("{error:#}; the flight continues");
                            is_reported = true;
                        }
                        Err(_) => {}
                    }
                }
                if is_over {
                    return;
                }
            }
        });
        let thread = thread.context("cannot start its thread")?;
        Ok(Some(Self { settings, stop: Some(stop), thread: Some(thread) }))
    }

    /// The settings for a session.
    pub fn settings(&self) -> signing::SigningSettings {
        self.settings.clone()
    }
}

impl Drop for SigningState {
    fn drop(&mut self) {
        drop(self.stop.take());
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// The ids of messages with these MAVLink names.
fn ids(names: &[String]) -> anyhow::Result<Vec<u32>> {
    let id = |name: &String| {
        MavMessage::message_id_from_name(name).ok_or_else(|| {
            anyhow!("accept_unsigned: no message is called {name:?}; names are MAVLink's")
        })
    };
    names.iter().map(id).collect()
}

fn read(path: &Path, key: &Key) -> anyhow::Result<Remembered> {
    let length = match fs::metadata(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Remembered::default()),
        found => {
            found.map(|it| it.len()).with_context(|| format!("cannot read {}", path.display()))?
        }
    };
    if length > FILE_LEN_MAX {
        bail!(
            "{} is not a signing state file: it has {length} bytes, expected at most \
             {FILE_LEN_MAX}",
            path.display()
        );
    }
    let text =
        fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    let file: StampsFile = serde_json::from_str(&text).with_context(|| {
        format!(
            "{} is not a signing state file; if its content is lost, remove it: messages of the \
             last minute can then be replayed once",
            path.display()
        )
    })?;
    if file.key != key.fingerprint() {
        bail!(
            "{} belongs to the key {}, expected {}; give each key its own state_file",
            path.display(),
            file.key,
            key.fingerprint()
        );
    }
    let stream = |row: &StreamRow| StreamStamp {
        id: StreamId { system: row.system, component: row.component, link: row.link },
        newest: Stamp::from_ticks(row.newest),
    };
    Ok(Remembered {
        newest: Stamp::from_ticks(file.newest.saturating_add(UNWRITTEN)),
        streams: file.streams.iter().map(stream).collect(),
    })
}

fn write(path: &Path, key: &Key, remembered: &Remembered) -> anyhow::Result<()> {
    let row = |stream: &StreamStamp| StreamRow {
        system: stream.id.system,
        component: stream.id.component,
        link: stream.id.link,
        newest: stream.newest.ticks(),
    };
    let file = StampsFile {
        schema: "downwash.signing.stamps".to_owned(),
        schema_version: 1,
        key: key.fingerprint(),
        newest: remembered.newest.ticks(),
        streams: remembered.streams.iter().map(row).collect(),
    };
    write_file(path, (serde_json::to_string(&file)? + "\n").as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder(name: &str) -> PathBuf {
        let path = std::env::temp_dir().join(format!("downwash-{name}-{}", std::process::id()));
        fs::create_dir_all(&path).expect("writable");
        path
    }

    fn key_file(folder: &Path) -> PathBuf {
        let path = folder.join("key");
        super::super::signing::write_key(&path, &Key::new([9; 32])).expect("new");
        path
    }

    #[test]
    fn stamps_continue_after_restart_and_foreign_key_state_is_refused() {
        let folder = folder("signing-state");
        let key_file = Some(key_file(&folder));
        let settings = SigningSettings { key_file, ..SigningSettings::default() };
        let id = StreamId { system: 1, component: 1, link: 0 };
        let streams = vec![StreamStamp { id, newest: Stamp::from_ticks(4) }];
        let first = SigningState::opened(&settings, None).expect("a key").expect("given");
        assert_eq!(first.settings.before, Remembered::default());
        let remembered =
            Remembered { newest: Stamp::from_ticks(1 << 47), streams: streams.clone() };
        let path = folder.join("key.stamps");
        write(&path, &Key::new([9; 32]), &remembered).expect("writable");
        drop(first);
        let again = SigningState::opened(&settings, None).expect("a key").expect("given");
        assert_eq!(again.settings.before.streams, streams);
        assert_eq!(again.settings.before.newest.ticks(), (1 << 47) + UNWRITTEN);
        drop(again);
        write(&path, &Key::new([8; 32]), &remembered).expect("writable");
        let error = SigningState::opened(&settings, None).err().expect("another key");
        assert!(error.to_string().contains("its own state_file"), "{error:#}");
        fs::write(&path, "{").expect("writable");
        assert!(SigningState::opened(&settings, None).is_err());
        fs::remove_dir_all(folder).expect("own");
    }

    #[test]
    fn key_has_one_source_and_requires_a_state_file() {
        let none = SigningSettings::default();
        assert!(SigningState::opened(&none, None).expect("nothing asked").is_none());
        let text = Key::new([9; 32]).to_hex();
        let given = Some(std::ffi::OsStr::new(&text));
        let error = SigningState::opened(&none, given).err().expect("no state").to_string();
        assert!(error.contains("state_file") && !error.contains(&text));
        let both = SigningSettings { key_file: Some("key".into()), ..none.clone() };
        assert!(SigningState::opened(&both, given).is_err());
        let wrong = Some(std::ffi::OsStr::new("12"));
        assert!(SigningState::opened(&none, wrong).is_err());
        assert!(ids(&["NO_SUCH".to_owned()]).is_err());
        assert_eq!(ids(&none.accept_unsigned).expect("known"), [109]);
    }
}
