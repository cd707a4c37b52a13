//! What is wrong with logs before any physics: faults of the data, and of the measurement.
//!
//! Nothing here knows a vehicle. What it finds is reported as what it is, and must not be passed
//! on as an effect of the vehicle: late or turned streams, biased sensors, gaps, frozen or
//! impossible values, files that are one flight twice.

mod agreement;
mod conventions;
mod duplicates;
mod finding;
mod kinematics;
mod motors;
mod pair;
mod rates;
mod rotors;
mod tier;
mod timing;
mod trial;
mod values;
mod vehicle;
mod weak;

use schemars::JsonSchema;
use serde::Serialize;

use crate::log::import::{Flight, RotorFact};
pub use agreement::{Agreement, Estimate};
pub use finding::{Finding, Severity};
pub use kinematics::Kinematics;
pub use rates::Rates;
pub use rotors::{Contradiction, RotorEffects};
pub use tier::{Channels, FAST_HZ, Tier};
pub use timing::{LEFT_OUT, NO_SAMPLES, StreamTiming};
pub(crate) use weak::median;

/// A time within which a stream must not be used.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize)]
pub struct UnusableSpan {
    /// The stream.
    pub stream: &'static str,
    /// From, s of the vehicle's clock.
    pub from_s: f64,
    /// To, s.
    pub to_s: f64,
    /// Why.
    pub reason: &'static str,
}

/// What a log is worth.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub struct Audit {
    /// The file.
    pub file: String,
    /// Name of the flight.
    pub run: String,
    /// `mcap`, `tlog`, `ulog`, `dataflash` or `csv`.
    pub format: &'static str,
    /// SHA-256 of the file.
    pub sha256: String,
    /// What was logged, as far as it decides what can be tested.
    pub channels: Channels,
    /// The most that the channels reach; `None` without a pose.
    pub tier: Option<Tier>,
    /// Rates, gaps and jitter of each stream.
    pub streams: Vec<StreamTiming>,
    /// How often streams bring something new.
    pub rates: Rates,
    /// By how much of itself the ground's clock ran faster than the vehicle's.
    pub ground_skew: Option<f64>,
    /// How the streams fit each other.
    pub kinematics: Kinematics,
    /// What each motor output does to the body, where the motion shows it.
    pub rotors: Option<RotorEffects>,
    /// What was found, worst first.
    pub findings: Vec<Finding>,
    /// Times that streams must not be used in, in their order.
    pub unusable: Vec<UnusableSpan>,
}

impl Audit {
    /// Audits one flight.
    pub fn of(flight: &Flight) -> Self {
        let kinematics = Kinematics::of(flight);
        let channels = Channels::of(flight);
        let mut audit = Self {
            file: flight.origin.path.display().to_string(),
            run: flight.origin.run.clone(),
            format: flight.origin.format,
            sha256: flight.origin.sha256.clone(),
            channels,
            tier: Tier::of(&channels),
            streams: timing::streams(flight),
            rates: Rates::of(flight),
            ground_skew: flight.ground_skew,
            kinematics,
            rotors: RotorEffects::of(flight),
            findings: Vec::new(),
            unusable: Vec::new(),
        };
        timing::check(flight, &mut audit);
        values::check(flight, &mut audit);
        vehicle::check(flight, &mut audit);
        motors::check(flight, &mut audit);
        conventions::check(flight, &mut audit);
        audit.sort();
        audit
    }

    /// Audits flights, and finds those that are one flight twice: the later one is at fault.
    pub fn of_all(flights: &[Flight]) -> Vec<Self> {
        use rayon::prelude::*;
        let mut audits: Vec<Self> = flights.par_iter().map(Self::of).collect();
        duplicates::check(flights, &mut audits);
        audits.iter_mut().for_each(Self::sort);
        audits
    }

    /// Whether the data are at fault: nothing may be concluded from the log before that is mended.
    pub fn is_faulty(&self) -> bool {
        self.findings.iter().any(|finding| finding.severity == Severity::Fault)
    }

    /// Faults for which the whole log is left out: those that are not a matter of some times of it.
    pub fn faults(&self) -> impl Iterator<Item = &Finding> {
        let faults = self.findings.iter().filter(|f| f.severity == Severity::Fault);
        faults.filter(|finding| finding.check != values::STOOD_STILL)
    }

    /// Adds a fault of the outputs' order against rotors that are known from elsewhere than the log;
    /// `whose` they are.
    pub(crate) fn check_order(&mut self, rotors: &[RotorFact; 4], whose: &str) {
        let is_known = self.findings.iter().any(|finding| finding.check == rotors::MOTOR_ORDER);
        let fault = self.rotors.and_then(|effects| effects.misordered(rotors, whose));
        self.findings.extend(fault.filter(|_| !is_known));
        self.sort();
    }

    fn sort(&mut self) {
        self.findings.sort_by_key(|finding| std::cmp::Reverse(finding.severity));
        self.unusable.sort_by(|a, b| a.from_s.total_cmp(&b.from_s));
    }
}
