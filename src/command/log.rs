//! `downwash log`: the content of flight logs, and reports on them.

use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow};

use super::import::Import;
use super::logs::check_own;
use super::output::{Output, check_output, refuse_input};
use super::patience::Patience;
use super::{Exit, ExitContext, audit, import, print_json, print_status, summary, write_file};
use crate::cli::{ExportFormat, LogCommand};
use crate::log::LogReader;
use crate::log::export::{ExportError, Format, export_all, export_topic};
use crate::log::import::{Choice, format_of, open_chosen};
use crate::log::info::LogInfo;
use crate::log::reader::ReadError;
use crate::report::{FlightReport, Recording};

pub(super) fn run(command: LogCommand) -> anyhow::Result<Exit> {
    match command {
        LogCommand::Info { files, json } => {
            for file in &files {
                let _patience = Patience::with(format!("reading {}", file.display()));
                let mut reader = open(file)?;
                let info = LogInfo::read(&mut reader);
                let info = info.with_context(|| file.display().to_string())?;
                if json { print_json(&info)? } else { print_info(file, &info) }
            }
            Ok(Exit::Ok)
        }
        LogCommand::Export { file, topic, format, out } => {
            let format = match format {
                ExportFormat::Csv => Format::Csv,
                ExportFormat::Jsonl => Format::JsonLines,
            };
            let _patience = Patience::with(format!("exporting {}", file.display()));
            export(&file, topic.as_deref(), format, out)
        }
        LogCommand::Import { file, choice, propose: _, out, json } => {
            let _patience = Patience::with(format!("importing {}", file.display()));
            let choice = choice.choice();
            import::run(Import { file: &file, choice, out: out.as_deref(), json })
        }
        LogCommand::Audit { logs, mapping, fail_on, json } => {
            let _patience = Patience::with(format!("auditing {}", counted(&logs)));
            audit::run(&logs, mapping.as_deref(), fail_on, json)
        }
        LogCommand::Report { file, choice, out, json } => {
            let _patience = Patience::with(format!("reading {}", file.display()));
            report(&file, choice.choice(), out, json)
        }
    }
}

/// The name of a log, or the number of several.
fn counted(logs: &[PathBuf]) -> String {
    match logs {
        [log] => log.display().to_string(),
        logs => format!("{} logs", logs.len()),
    }
}

/// Writes the report on a flight: one of this program's, or any other that can be imported.
fn report(
    file: &Path,
    choice: Choice<'_>,
    out: Option<PathBuf>,
    json: bool,
) -> anyhow::Result<Exit> {
    let out = out.unwrap_or_else(|| file.with_extension("html"));
    check_output(&out, [file])?;
    let own = match LogReader::open(file) {
        Ok(mut reader) => {
            let report = FlightReport::read(&mut reader);
            let report = report.with_context(|| file.display().to_string())?;
            (!report.is_empty()).then(|| summary::with_recording(report, file))
        }
        Err(error @ ReadError::Open { .. }) => return Err(error).or_exit(Exit::Usage),
        Err(_) => None,
    };
    if let Some(report) = own {
        check_own(file, choice).or_exit(Exit::Usage)?;
        write_file(&out, report.to_html().as_bytes())?;
        if json {
            print_json(report.summary())?;
        }
    } else {
        let flight = open_chosen(file, choice).or_exit(Exit::Usage)?;
        let report = Recording::new(flight);
        write_file(&out, report.to_html().as_bytes())?;
        if json {
            print_json(report.summary())?;
        }
    }
    if !json {
        println!("{}", out.display());
    }
    Ok(Exit::Ok)
}

/// Opens a log; errors name the file.
fn open(file: &Path) -> anyhow::Result<LogReader<BufReader<File>>> {
    let reader = LogReader::open(file);
    match reader {
        Err(error @ ReadError::Open { .. }) => Err(error).or_exit(Exit::Usage),
        Err(ReadError::NotMcap { .. }) => Err(not_imported(file)).or_exit(Exit::Usage),
        reader => reader.with_context(|| file.display().to_string()).or_exit(Exit::Usage),
    }
}

/// Why a file that is no MCAP file cannot be read here, and what makes a log of it.
fn not_imported(file: &Path) -> anyhow::Error {
    match format_of(file) {
        Ok(format) => {
            let mapping = if format == "csv" { " --mapping MAP.toml" } else { "" };
            let (name, log) = (file.display(), file.with_extension("mcap"));
            anyhow!(
                "{name}: expected a downwash log (.mcap), found a {format} log; convert it first: \
                 downwash log import {name}{mapping} -o {}",
                log.display()
            )
        }
        Err(error) => error.into(),
    }
}

/// Writes one topic to a file or to stdout, or all into a folder.
fn export(
    file: &Path,
    topic: Option<&str>,
    format: Format,
    out: Option<PathBuf>,
) -> anyhow::Result<Exit> {
    let name = || file.display().to_string();
    let mut reader = open(file)?;
    let exported = match (topic, out) {
        (Some(topic), out) => {
            if let Some(out) = &out {
                check_output(out, [file])?;
            }
            let mut sink = Output::to(out.as_deref())?;
            let named = || out.as_ref().map_or_else(name, |out| out.display().to_string());
            match export_topic(&mut reader, topic, format, &mut sink) {
                Ok(_) => sink.finish(),
                Err(error @ ExportError::Write(_)) => Err(error).with_context(named),
                Err(error) => Err(error).with_context(name).or_exit(Exit::Usage),
            }
        }
        (None, Some(folder)) => {
            // The files are named after topics: the log can be one of them only if it has such a
            // name.
            let is_named_so =
                file.extension().is_some_and(|e| ["csv", "jsonl", "part"].iter().any(|x| e == *x));
            if let Some(name) = file.file_name().filter(|_| is_named_so) {
                refuse_input(&folder.join(name), [file])?;
            }
            export_all(&mut reader, &folder, format).with_context(name).map(|written| {
                for (path, rows) in written {
                    print_status(format_args!("{}: {rows} rows", path.display()));
                }
            })
        }
        (None, None) => {
            let choice = "name one --topic, or a folder for all of them with --out";
            return Err(anyhow!("nothing to export: {choice}")).or_exit(Exit::Usage);
        }
    };
    // Also after a failed export: the topic may be in the damaged part.
    let (file, ending) = (file.display(), reader.ending());
    for damage in &ending.damages {
        print_status(format_args!("{file}: damaged, rows left out: {damage}"));
    }
    let more = ending.damaged.saturating_sub(ending.damages.len() as u64);
    if more > 0 {
        print_status(format_args!("{file}: and {more} more damaged parts"));
    }
    exported?;
    if !ending.finished {
        print_status(format_args!("{file}: unfinished log, exported its complete part"));
    }
    Ok(Exit::Ok)
}

fn print_info(file: &Path, info: &LogInfo) {
    let state = if info.finished { "finished" } else { "unfinished log" };
    let (messages, duration) = (info.messages, info.duration_s);
    println!("{}: {state}, {messages} messages over {duration:.2} s", file.display());
    for damage in &info.damages {
        println!("  damaged: {damage}");
    }
    for (key, value) in &info.run {
        println!("  {key}: {value}");
    }
    for (name, bytes) in &info.attachments {
        println!("  attachment {name}: {bytes} bytes");
    }
    println!("  {:<18} {:>9} {:>9} {:>9}  schema", "topic", "messages", "rate/Hz", "gap/s");
    for topic in &info.topics {
        let rate = topic.rate_hz.map_or("-".to_owned(), |rate| format!("{rate:.1}"));
        let (name, count, gap) = (&topic.topic, topic.messages, topic.longest_gap_s);
        println!("  {name:<18} {count:>9} {rate:>9} {gap:>9.3}  {}", topic.schema);
    }
    for phase in &info.phases {
        println!("  {:8.2} s  {:<18} {:.2} s", phase.start_s, phase.name, phase.duration_s);
    }
    if let Some(t) = &info.tracking {
        println!(
            "  tracking over {} ticks: RMSE north {:.3}, east {:.3}, down {:.3}, 3D {:.3} m; max \
             {:.3} m",
            t.ticks, t.rmse_n_m, t.rmse_e_m, t.rmse_d_m, t.rmse_3d_m, t.max_3d_m
        );
    }
    if let Some(battery) = &info.battery {
        let volts = |v: Option<f64>| v.map_or("unknown".to_owned(), |v| format!("{v:.2} V"));
        println!("  battery: {} to {}", volts(battery.voltage_min_v), volts(battery.voltage_max_v));
    }
    for event in &info.events {
        println!("  {:8.2} s  {} ({}): {}", event.time_s, event.level, event.source, event.text);
    }
    let more = info.events_total.saturating_sub(info.events.len() as u64);
    if more > 0 {
        println!("  and {more} more events");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn other_logs_are_named_with_the_command_that_converts_them() {
        let folder = std::env::temp_dir().join(format!("downwash-log-{}", std::process::id()));
        std::fs::create_dir_all(&folder).expect("a folder");
        let refusal = |name: &str, content: &[u8]| {
            let file = folder.join(name);
            std::fs::write(&file, content).expect("a file");
            super::super::error_text(&open(&file).err().expect("no log of this program"))
        };
        for (name, content, format) in [
            ("a.ulg", b"ULog\x01\x12\x35\x01".as_slice(), "a ulog log"),
            ("a.bin", b"\xA3\x95\x80\x80\x59FMT\0", "a dataflash log"),
            ("a.csv", b"t,x,y\n0,1,2\n1,1,2\n", "a csv log"),
        ] {
            let refused = refusal(name, content);
            let is_named = refused.contains(name) && refused.contains(format);
            assert!(is_named && refused.contains("downwash log import"), "{refused}");
            assert_eq!(refused.contains("--mapping"), name == "a.csv", "{refused}");
        }
        let text = refusal("a.txt", b"some words\n");
        assert!(text.contains("a.txt") && text.contains("not a flight log"), "{text}");
        std::fs::remove_dir_all(&folder).expect("a folder");
    }
}
