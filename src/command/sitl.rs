//! `downwash sitl`: the simulated vehicle on its links.

use std::time::Duration;

use sitl::autopilot::Vehicle;
use sitl::cli::{SitlError, Stop};
use vehicle::VehicleParams;
use vehicle::frame::Frd;

use super::audience::print_address;
use super::vehicle_file::VehicleFile;
use super::{Exit, ExitContext};
use crate::cli::SimulatorArgs;
use crate::clock::HostTime;
use crate::daemon::HostClock;
use crate::lockstep;
use crate::log::sink::Listener;
use crate::memory;
use crate::view::{CoursePath, LiveFeed, LiveView, ViewSettings};

/// Period at which the view receives the vehicle's state.
const VIEW_PERIOD: Duration = Duration::from_millis(20);

pub(super) fn run(args: &SimulatorArgs) -> anyhow::Result<Exit> {
    // Reads the file for the warnings about numbers that do not fit each other.
    let vehicle = VehicleFile::load(&args.vehicle.vehicle)?;
    memory::lock();
    let ended = match &args.view.view {
        None => sitl::cli::run(&args.vehicle),
        Some(requested) => {
            let mut watched = Watched::start(requested, &vehicle.params)?;
            sitl::cli::run_watched(&args.vehicle, |vehicle| watched.see(vehicle))
        }
    };
    match ended {
        Ok(Stop::Interrupt) => Ok(Exit::Interrupted),
        Ok(Stop::Terminate) => Ok(Exit::Ok),
        Err(error) => {
            let exit = match error {
                SitlError::Link(_) => Exit::Link,
                SitlError::Runtime(_) => Exit::Failure,
                _ => Exit::Usage,
            };
            Err(error).or_exit(exit)
        }
    }
}

/// The true state of the vehicle, in a live view.
struct Watched {
    _view: LiveView,
    feed: LiveFeed,
    clock: HostClock,
    next: HostTime,
}

impl Watched {
    fn start(address: &str, params: &VehicleParams) -> anyhow::Result<Self> {
        let settings = ViewSettings {
            address: address.to_owned(),
            name: format!("downwash sitl: {}", params.name),
            ..ViewSettings::default()
        };
        let rotors = params.rotors.map(|rotor| Frd::from(rotor.position_m));
        let (view, feed) =
            LiveView::start(settings, &rotors, CoursePath::default()).or_exit(Exit::Usage)?;
        print_address(view.address());
        let clock = HostClock::start();
        Ok(Self { _view: view, feed: feed.alone(), clock, next: HostTime::default() })
    }

    fn see(&mut self, vehicle: &Vehicle) {
        let now = self.clock.now();
        if now >= self.next {
            self.next = now + VIEW_PERIOD;
            self.feed.on_record(&lockstep::truth(vehicle, now));
        }
    }
}
