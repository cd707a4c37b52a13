//! Who watches a flight: the terminal, and viewers of the live view.

use std::collections::BTreeMap;
use std::io::IsTerminal;

use vehicle::VehicleParams;
use vehicle::frame::Ned;

use super::course::Course;
use super::lap_course::{self, Lines};
use super::screen::Screen;
use super::status_line::StatusLine;
use super::stop::Stop;
use super::{Exit, ExitContext, print_status};
use crate::cli::{FlightViewArgs, ForwardArgs, ServiceArgs, ViewArgs};
use crate::clock::HostTime;
use crate::config::Config;
use crate::forward::{AllowList, Forward, Guests};
use crate::health::{HealthView, Monitor};
use crate::lap_learning::LapLearner;
use crate::log::RunInfo;
use crate::log::sink::Listeners;
use crate::onset::detector::Settings;
use crate::plan::outline;
use crate::service::Service;
use crate::station::Status;
use crate::view::{Changes, CoursePath, LiveView, ViewSettings};

/// Period of the points that a course is drawn with, and the most of them.
const COURSE_PERIOD_S: f64 = 0.05;
const COURSE_POINTS: usize = 20_000;

/// All who watch one flight.
#[derive(Default)]
pub(super) struct Audience {
    view: Option<LiveView>,
    listeners: Listeners,
    guests: Option<Guests>,
    screen: Option<Screen>,
    service: Option<Service>,
    line: Option<StatusLine>,
    health: Option<HealthView>,
    /// Changes of the vehicle that were reported.
    reported: u64,
    /// Messages of a learner for the terminal.
    lines: Option<Lines>,
}

impl Audience {
    /// Starts what the flags ask for.
    pub fn start(
        args: &ViewArgs,
        config: &Config,
        run: &RunInfo,
        course: &Course,
    ) -> anyhow::Result<Self> {
        let Some(requested) = &args.view else { return Ok(Self::default()) };
        Self::seen(view_settings(requested, run, config), run, course)
    }

    /// As [`start`](Self::start), for a flight in which viewers may request changes.
    pub fn start_for_flight(
        args: &FlightViewArgs,
        config: &Config,
        run: &RunInfo,
        course: &Course,
    ) -> anyhow::Result<Self> {
        let Some(requested) = &args.watch.view else { return Ok(Self::default()) };
        let is_writable = args.view_write;
        let settings = ViewSettings { is_writable, ..view_settings(requested, run, config) };
        let audience = Self::seen(settings, run, course)?;
        if is_writable {
            print_status(format_args!("viewers may move the goal and scale the feedback"));
        }
        Ok(audience)
    }

    fn seen(settings: ViewSettings, run: &RunInfo, course: &Course) -> anyhow::Result<Self> {
        let (view, feed) =
            LiveView::start(settings, &run.rotors, path(course)).or_exit(Exit::Usage)?;
        print_address(view.address());
        Ok(Self { view: Some(view), listeners: vec![Box::new(feed)], ..Self::default() })
    }

    /// Also forwards the vehicle's frames to other ground stations.
    pub fn forwarding(mut self, args: &ForwardArgs, config: &Config) -> anyhow::Result<Self> {
        let allow = AllowList::new(&config.settings.forward.allow).or_exit(Exit::Usage)?;
        if !args.forward.is_empty() {
            let (forward, guests) = Forward::start(&args.forward, allow).or_exit(Exit::Usage)?;
            self.listeners.push(Box::new(forward));
            self.guests = Some(guests);
        }
        Ok(self)
    }

    /// Also watches whether the vehicle changes, if the settings say so.
    pub fn monitored(mut self, vehicle: &VehicleParams, config: &Config) -> anyhow::Result<Self> {
        let health = &config.settings.health;
        if health.monitor {
            let settings = Settings { false_alarm_h: health.false_alarm_h, ..Settings::LIVE };
            let monitor = Monitor::new(vehicle, settings).or_exit(Exit::Usage)?;
            self.health = Some(monitor.view());
            self.listeners.push(Box::new(monitor));
        }
        Ok(self)
    }

    /// Adds a learner as a listener, if there is one.
    pub fn learning(mut self, learner: Option<LapLearner>) -> anyhow::Result<Self> {
        if let Some(learner) = learner {
            let (queue, lines) = lap_course::start(learner)?;
            self.listeners.push(Box::new(queue));
            self.lines = Some(lines);
        }
        Ok(self)
    }

    /// Also serves health, status and metrics to monitors.
    pub fn served(mut self, args: &ServiceArgs) -> anyhow::Result<Self> {
        if let Some(requested) = &args.metrics {
            let service = Service::start(requested).or_exit(Exit::Usage)?;
            print_status(format_args!("metrics at http://{}/metrics", service.address()));
            self.service = Some(service);
        }
        Ok(self)
    }

    /// Also shows the flight on the whole terminal.
    pub fn on_screen(mut self, is_requested: bool, run: &RunInfo) -> anyhow::Result<Self> {
        if is_requested {
            let view = self.view.as_ref().map(|view| format!("   http://{}/", view.address()));
            let view = view.unwrap_or_default();
            let screen = Screen::start(format!("downwash: {}, {}{view}", run.vehicle, run.run))?;
            self.listeners.push(Box::new(screen.content()));
            self.screen = Some(screen);
        }
        Ok(self)
    }

    /// The frames of other ground stations for the vehicle; `None` from the second call on.
    pub fn take_guests(&mut self) -> Option<Guests> {
        self.guests.take()
    }

    /// The changes that viewers request, if they may; `None` from the second call on.
    pub fn take_changes(&mut self) -> Option<Changes> {
        self.view.as_ref().and_then(LiveView::take_changes)
    }

    /// The listeners to the flight's records; `None` from the second call on.
    pub fn take_listeners(&mut self) -> Listeners {
        std::mem::take(&mut self.listeners)
    }

    /// Shows a status line until [`finish`](Self::finish), unless there is a screen.
    pub fn begin(&mut self) {
        if self.screen.is_none() {
            self.line = Some(StatusLine::new(std::io::stderr().is_terminal()));
        }
    }

    /// Shows the status; returns what a key requested since the last call.
    pub fn show(&mut self, now: HostTime, status: &Status) -> Option<Stop> {
        if let Some(view) = &self.view {
            view.show(now, status);
        }
        if let Some(health) = self.health.as_ref().map(HealthView::get)
            && health.count > self.reported
        {
            self.reported = health.count;
            if self.screen.is_none() {
                print_status(format_args!("{}", health.latest.unwrap_or_default()));
            }
        }
        if let Some(lines) = self.lines.as_ref().filter(|_| self.screen.is_none()) {
            lines.try_iter().for_each(|line| print_status(format_args!("{line}")));
        }
        if let Some(service) = &self.service {
            service.show(now, status, self.health.as_ref());
        }
        if let Some(line) = &self.line {
            line.show(status);
        }
        self.screen.as_mut().and_then(|screen| screen.show(status))
    }

    /// Gives the terminal back.
    pub fn finish(&mut self) {
        if let Some(line) = self.line.take() {
            line.finish();
        }
        self.screen = None;
    }
}

/// Prints the address of the view.
pub(super) fn print_address(address: std::net::SocketAddr) {
    print_status(format_args!("view at http://{address}/ (Foxglove: ws://{address})"));
    if !address.ip().is_loopback() {
        print_status(format_args!("anyone who can reach {address} can watch"));
    }
}

/// The settings of a view at `address`.
fn view_settings(address: &str, run: &RunInfo, config: &Config) -> ViewSettings {
    let settings = config.rows().map(|(name, value, _)| {
        let text = value.as_str().map_or_else(|| value.to_string(), str::to_owned);
        (name, text)
    });
    ViewSettings {
        address: address.to_owned(),
        name: format!("downwash: {}, {}", run.vehicle, run.run),
        parameters: settings.collect::<BTreeMap<_, _>>(),
        playback: None,
        is_writable: false,
    }
}

/// The course as a line. A course that is replanned in flight is drawn as it begins.
fn path(course: &Course) -> CoursePath {
    let start = course.at_start();
    // The line shows positions only, so any thrust will do.
    let reference = start.reference(0.0);
    let count = (reference.duration() / COURSE_PERIOD_S).ceil();
    let period_s = COURSE_PERIOD_S * (count / COURSE_POINTS as f64).max(1.0);
    let count = (count as usize).min(COURSE_POINTS);
    let times = || (0..=count).map(|index| index as f64 * period_s);
    let points: Vec<Ned> = times().map(|t| reference.desired(t)).collect();
    let radii: Option<Vec<f64>> = times().map(|t| reference.tube_radius_m(t)).collect();
    let tube = radii.map_or(Vec::new(), |radii| outline(&points, &radii));
    CoursePath { period_s, points, tube }
}
