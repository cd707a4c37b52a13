//! What `train` and `plan` refuse by their arguments alone, before any work.

use std::fs;
use std::path::{Path, PathBuf};

use crate::learn;
use crate::learn::{downwash, folder};

/// Runs a command that must be refused as wrong usage; returns its message.
fn refused(folder: &Path, arguments: &[&Path]) -> String {
    let output = downwash(folder).args(arguments).output().expect("the command runs");
    let errors = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{arguments:?}: {errors}");
    errors
}

fn train(vehicle: &Path, out: &Path, more: &[&Path]) -> Vec<PathBuf> {
    let words = ["train", "--vehicle"].map(Path::new);
    let words = words.into_iter().chain([vehicle, Path::new("-o"), out]);
    words.chain(more.iter().copied()).map(Path::to_owned).collect()
}

fn borrowed(arguments: &[PathBuf]) -> Vec<&Path> {
    arguments.iter().map(PathBuf::as_path).collect()
}

#[test]
fn input_files_are_never_overwritten() {
    let folder = folder("inputs");
    let file = |name: &str| {
        let path = folder.join(name);
        fs::write(&path, name).expect("a file");
        path
    };
    let names = ["a.mcap", "b.mcap", "v.toml", "m.toml", "o.checkpoint", "t.toml", "p.safetensors"];
    let [first, second, vehicle, mapping, checkpoint, trajectory, model] = names.map(file);
    let log = first.as_path();
    let by_mapping = [log, Path::new("--mapping"), &mapping];
    for arguments in [
        train(&vehicle, log, &[log, &second]),
        train(&vehicle, &second, &[log, &second]),
        train(&vehicle, &vehicle, &[log]),
        train(&vehicle, &mapping, &by_mapping),
        train(&vehicle, &folder.join("o"), &[log, &checkpoint]),
    ] {
        let errors = refused(&folder, &borrowed(&arguments));
        assert!(errors.contains("it would overwrite"), "{arguments:?}: {errors}");
    }
    let [plan, out, with] = ["plan", "-o", "--model"].map(Path::new);
    let (on, config) = (Path::new("--vehicle"), Path::new("--config"));
    for arguments in [
        vec![plan, &trajectory, out, &trajectory],
        vec![plan, &trajectory, with, &model, out, &model],
        vec![plan, &trajectory, on, &vehicle, out, &vehicle],
        vec![plan, &trajectory, config, &mapping, out, &mapping],
    ] {
        let errors = refused(&folder, &arguments);
        assert!(errors.contains("it would overwrite"), "{arguments:?}: {errors}");
    }
    for name in names {
        assert_eq!(fs::read_to_string(folder.join(name)).expect("the file"), name);
    }
}

#[test]
fn invalid_arguments_are_refused_before_any_work() {
    let folder = folder("arguments");
    let report = folder.join("report");
    fs::write(&report, "a file").expect("a file");
    let (vehicle, out) = (learn::vehicle(), folder.join("model"));
    let log = vehicle.as_path();
    for (flag, value, words) in [
        ("--regularization", "1e-5,1.5", "at least 0 and below 1, found 1.5"),
        ("--threads", "100000", "100000"),
        ("--threads", "0", "0"),
        ("--report", &*report.to_string_lossy(), "--report: cannot create the folder"),
    ] {
        let arguments = train(&vehicle, &out, &[log, Path::new(flag), Path::new(value)]);
        let errors = refused(&folder, &borrowed(&arguments));
        assert!(errors.contains(words), "{flag} {value}: {errors}");
    }
    let trajectory = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/trajectories/hover.toml");
    let words = ["plan", "--report", "-o"].map(Path::new);
    let errors = refused(&folder, &[words[0], &trajectory, words[1], &report, words[2], &out]);
    assert!(errors.contains("--report: cannot create the folder"), "{errors}");
}
