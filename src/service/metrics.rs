//! A status in Prometheus' text format.

use std::fmt::{Display, Write};

use crate::station::Status;
use crate::supervisor::STATES;

struct Page(String);

impl Page {
    fn family(&mut self, name: &str, kind: &str, help: &str) {
        let _ = writeln!(self.0, "# HELP downwash_{name} {help}\n# TYPE downwash_{name} {kind}");
    }

    fn value(&mut self, name: &str, labels: &str, value: impl Display) {
        let _ = writeln!(self.0, "downwash_{name}{labels} {value}");
    }

    fn gauge(&mut self, name: &str, help: &str, value: Option<f64>) {
        let Some(value) = value else { return };
        self.family(name, "gauge", help);
        self.value(name, "", value);
    }

    fn counter(&mut self, name: &str, help: &str, value: u64) {
        self.family(name, "counter", help);
        self.value(name, "", value);
    }
}

/// All metrics of a status of this age. Unknown values are left out.
pub(super) fn text(status: &Status, changes: u64, age_s: Option<f64>) -> String {
    let mut page = Page(String::new());
    page.family("build_info", "gauge", "Version of the program.");
    page.value("build_info", &format!("{{version=\"{}\"}}", env!("CARGO_PKG_VERSION")), 1);
    page.gauge("status_age_seconds", "Age of the other values.", age_s);
    let connected = f64::from(u8::from(status.link == "connected"));
    page.gauge("link_connected", "Whether messages arrive from the vehicle.", Some(connected));
    page.family("flight_state", "gauge", "1 for the flight's present state, else 0.");
    for state in STATES {
        let name = serde_json::to_value(state).unwrap_or_default();
        let labels = format!("{{state=\"{}\"}}", name.as_str().unwrap_or_default());
        page.value("flight_state", &labels, u8::from(status.phase == Some(state)));
    }
    let armed = status.armed.map(|armed| f64::from(u8::from(armed)));
    page.gauge("armed", "Whether the motors are armed.", armed);
    page.gauge("control_tick_hertz", "Control ticks a second.", Some(status.tick_rate_hz));
    page.gauge(
        "tracking_error_meters",
        "Distance from the reference.",
        Some(status.tracking_error_m),
    );
    page.family("position_meters", "gauge", "Position in the local frame.");
    for (axis, value) in ["north", "east", "down"].into_iter().zip(status.position.to_array()) {
        page.value("position_meters", &format!("{{axis=\"{axis}\"}}"), value);
    }
    page.gauge("battery_ratio", "Remaining charge.", status.battery);
    page.gauge("link_round_trip_seconds", "Round trip of the link.", status.round_trip_s);
    page.counter("setpoints_total", "Setpoints sent.", status.setpoints);
    let counts = &status.counts;
    page.counter(
        "link_frames_heard_total",
        "Frames received from the vehicle.",
        counts.vehicle_frames,
    );
    page.counter("link_frames_lost_total", "Frames from the vehicle that were lost.", counts.lost);
    page.counter("link_frames_repeated_total", "Frames received twice or late.", counts.repeated);
    page.counter("link_frames_refused_total", "Frames that cannot be true.", counts.refused);
    page.counter("link_frames_foreign_total", "Frames from other senders.", counts.foreign);
    page.counter("link_frames_sent_total", "Frames sent.", counts.sent);
    page.counter("link_frames_dropped_total", "Frames that could not be sent.", counts.dropped);
    page.counter("link_bytes_unframed_total", "Bytes that are not MAVLink.", counts.unframed_bytes);
    page.family("link_frames_disbelieved_total", "counter", "Frames without a valid signature.");
    for (why, count) in &counts.rejected_frames {
        let labels = format!("{{why=\"{}\"}}", why.name());
        page.value("link_frames_disbelieved_total", &labels, count);
    }
    page.counter(
        "log_records_dropped_total",
        "Log records dropped because the disk was too slow.",
        status.log_dropped,
    );
    page.counter("vehicle_changes_total", "Changes of the vehicle that were reported.", changes);
    page.counter("log_failures_total", "Logs that ended with an error.", status.log_failures);
    page.0
}
