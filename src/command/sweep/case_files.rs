//! The files in the folder of a case.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// Extensions of the logs in a case's folder.
const LOGS: [&str; 4] = ["tlog", "mcap", "ulg", "bin"];
/// Names of the vehicle file there.
const VEHICLES: [&str; 2] = ["vehicle.toml", "vehicle.json"];

/// The files of a case.
pub(super) struct CaseFiles {
    pub vehicle: PathBuf,
    pub logs: Vec<PathBuf>,
}

impl CaseFiles {
    /// The files of a case's folder.
    ///
    /// # Errors
    /// A folder that cannot be read.
    pub fn in_folder(folder: &Path) -> io::Result<Self> {
        let mut logs = Vec::new();
        for entry in fs::read_dir(folder)? {
            let path = entry?.path();
            let extension = path.extension().and_then(|extension| extension.to_str());
            if extension.is_some_and(|extension| LOGS.contains(&extension)) {
                logs.push(path);
            }
        }
        logs.sort();
        let vehicles = VEHICLES.map(|name| folder.join(name));
        let [usual, _] = &vehicles;
        let vehicle = vehicles.iter().find(|path| path.exists()).unwrap_or(usual).clone();
        Ok(Self { vehicle, logs })
    }
}
