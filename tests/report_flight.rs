//! The flight report agrees with the log, whatever condition the log is in.

use std::fs;
use std::path::{Path, PathBuf};

use crate::log_flight::{START, records, write};
use downwash::log::info::LogInfo;
use downwash::log::record::{Severity, Source};
use downwash::log::{LogReader, Record};
use downwash::report::FlightReport;

fn log(name: &str, records: &[Record]) -> PathBuf {
    let directory = Path::new(env!("CARGO_TARGET_TMPDIR")).join("report_flight").join(name);
    let _ = fs::remove_dir_all(&directory);
    write(&directory, records)
}

fn report(path: &Path) -> FlightReport {
    FlightReport::read(&mut LogReader::open(path).unwrap()).unwrap()
}

/// The readable part of the page: everything except the script.
fn drawn(html: &str) -> &str {
    html.split("<script>").next().unwrap()
}

#[test]
fn report_is_self_contained() {
    let path = log("whole", &records(22.5));
    let report = report(&path);
    let html = report.to_html();
    fs::write(path.with_extension("html"), &html).unwrap();
    assert!(html.len() < 1_500_000, "{} bytes", html.len());
    for outside in ["http:", "https:", "src=", "@import", "url(", "fetch(", "import("] {
        assert!(!html.contains(outside), "{outside}");
    }
    // Links lead to existing parts of the page.
    for link in html.split("href=\"").skip(1).map(|rest| rest.split('"').next().unwrap()) {
        let part = link.strip_prefix('#').expect("a part of the page");
        assert!(html.contains(&format!("id=\"{part}\"")), "{link}");
    }
    for broken in ["NaN", "inf ", "infinity"] {
        assert!(!drawn(&html).contains(broken), "{broken}");
    }
    assert!(html.contains("Tracked for 15.7 s"), "the sentence states the duration");
    assert!(html.contains("Low battery, &quot;10 %&quot;"));
}

#[test]
fn ten_minute_report_is_small_enough_to_send() {
    let path = log("ten_minutes", &records(600.0));
    let flight = downwash::log::import::open(&path, None);
    let report = report(&path);
    let report = match flight {
        Ok(flight) => report.with_recording(flight),
        Err(_) => report,
    };
    let html = report.to_html();
    assert!(html.len() < 3_000_000, "{} bytes", html.len());
}

#[test]
fn summary_counts_ticks_and_events() {
    let mut records = records(10.0);
    // A pause of four ticks.
    let mut tick = 0;
    records.retain(|r| {
        tick += u32::from(matches!(r, Record::Tick(_)));
        !(matches!(r, Record::Tick(_)) && (500..503).contains(&tick))
    });
    let report = report(&log("paused", &records));
    let summary = report.summary();
    assert_eq!((summary.control.ticks, summary.control.missed_ticks), (997, 3));
    assert!((summary.control.rate_hz.unwrap() - 100.0).abs() < 1e-6);
    assert_eq!(summary.control.limited_ticks, 1);
    assert_eq!(summary.events["warning"], 1);
    assert!(summary.link.as_ref().unwrap().rtt_max_s.unwrap() < 0.002);
    let json = serde_json::to_value(summary).unwrap();
    assert_eq!(json["schema"], "downwash.report.flight");
    assert_eq!(json["schema_version"], 1);
    assert!(json["tracking"]["rmse_3d_m"].as_f64().unwrap() > 0.0);
}

#[test]
fn unlisted_events_are_counted_by_level() {
    let event = |severity| Record::Event {
        host: START,
        severity,
        source: Source::Vehicle,
        text: "again".to_owned(),
    };
    let mut records = vec![event(Severity::Info); 1200];
    records.extend(vec![event(Severity::Error); 7]);
    let path = log("chatty", &records);
    let report = report(&path);
    assert_eq!((report.summary().events["info"], report.summary().events["error"]), (1200, 7));
    assert!(report.to_html().contains("7 events of level error or worse"));
    let info = LogInfo::read(&mut LogReader::open(&path).unwrap()).unwrap();
    assert_eq!((info.events.len(), info.events_total), (1000, 1207));
}

#[test]
fn unfinished_and_empty_logs_are_reported_as_such() {
    let path = log("cut", &records(3.0));
    let bytes = fs::read(&path).unwrap();
    for length in [bytes.len() - 40, bytes.len() / 2, 20, 0] {
        let mut reader = LogReader::new(&bytes[..length]).unwrap();
        let report = FlightReport::read(&mut reader).unwrap();
        assert!(!report.summary().log_finished);
        let html = report.to_html();
        assert!(html.contains("the log is unfinished") && !drawn(&html).contains("NaN"));
    }
}
