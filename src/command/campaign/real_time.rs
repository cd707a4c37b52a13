//! The station's process of a flight in real time: this program, with its files in a folder.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::AtomicBool;

use anyhow::Context;
use toml::{Table, Value};

use super::kit::kit;
use crate::campaign::kit::Flown;
use crate::campaign::live;
use crate::campaign::script::Script;
use crate::command::signing::write_key;
use crate::command::vehicle_file::VehicleFile;
use crate::command::{program, write_file};
use crate::supervisor::EngagePolicy;

/// The process's output.
const OUTPUT_FILE: &str = "station.txt";
const CONFIG: &str = "downwash.toml";
const VEHICLE: &str = "vehicle.toml";
const TRAJECTORY: &str = "trajectory.toml";
const KEY: &str = "signing.key";

/// Flies a script in real time, with its files in a folder, which stays where a rule did not hold.
pub(super) fn flown(script: &Script, folder: &Path, stop: &AtomicBool) -> anyhow::Result<Flown> {
    let script = live::playable(script);
    let post = Post::new(folder.to_owned(), &script)?;
    let mut flown = live::fly(&script, &kit(&script)?, &|port| post.command(port), stop)?;
    flown.end = format!("{}: {}", flown.end, post.last_line());
    if flown.violations.is_empty() {
        let _ = fs::remove_dir_all(folder);
    }
    Ok(flown)
}

/// A folder with what `fly` or `daemon` needs to fly a script.
struct Post {
    folder: PathBuf,
    program: PathBuf,
    policy: EngagePolicy,
    config: Table,
}

impl Post {
    /// Makes the folder, anew.
    fn new(folder: PathBuf, script: &Script) -> anyhow::Result<Self> {
        let shown = || folder.display().to_string();
        if folder.exists() {
            fs::remove_dir_all(&folder).with_context(shown)?;
        }
        fs::create_dir_all(&folder).with_context(shown)?;
        let vehicle = VehicleFile::load(Path::new(&script.vehicle))?;
        write_file(&folder.join(VEHICLE), vehicle.text.as_bytes())?;
        write_file(&folder.join(TRAJECTORY), script.trajectory.as_bytes())?;
        let text = |text: &str| Value::String(text.to_owned());
        let table = |key: &str, value| Table::from_iter([(key.to_owned(), value)]);
        let mut config = Table::from_iter([
            ("schema_version".to_owned(), Value::Integer(1)),
            ("vehicle".to_owned(), text(VEHICLE)),
            ("trajectory".to_owned(), text(TRAJECTORY)),
            ("log_dir".to_owned(), text("logs")),
            ("control".to_owned(), table("law", text(&script.law)).into()),
        ]);
        if script.signed {
            write_key(&folder.join(KEY), &live::key()).with_context(shown)?;
            let signing = table("key_file", text(KEY));
            config.insert("link".to_owned(), table("signing", signing.into()).into());
        }
        let program = program()?;
        Ok(Self { folder, program, policy: script.policy, config })
    }

    /// The command that starts the program, listening at `port`.
    fn command(&self, port: u16) -> io::Result<Command> {
        let mut config = self.config.clone();
        config.insert("connect".to_owned(), Value::String(format!("udpin:127.0.0.1:{port}")));
        let path = self.folder.join(CONFIG);
        fs::write(&path, config.to_string())?;
        let output =
            File::options().create(true).append(true).open(self.folder.join(OUTPUT_FILE))?;
        let mut command = Command::new(&self.program);
        match self.policy {
            EngagePolicy::Command => command.arg("fly").arg(self.folder.join(TRAJECTORY)),
            EngagePolicy::PilotSwitch => command.arg("daemon"),
        };
        command.arg("--config").arg(path).stdin(Stdio::null());
        command.stdout(output.try_clone()?).stderr(output);
        Ok(command)
    }

    /// The last line of the process's output.
    fn last_line(&self) -> String {
        let output = fs::read_to_string(self.folder.join(OUTPUT_FILE)).unwrap_or_default();
        output.lines().last().unwrap_or_default().to_owned()
    }
}
