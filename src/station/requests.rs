//! The offboard controller's actions as requests on the link, and the answers to them.

use super::Station;
use super::identification::log_parameters;
use crate::clock::HostTime;
use crate::link::request::{FlightMode, Outcome, Request};
use crate::log::record::{PARAMETER_FACT, Record, Severity};
use crate::offboard::LinkEvent;
use crate::supervisor::Action;

/// The request that carries out an action of the offboard controller.
pub(super) fn request_of(action: Action) -> Request {
    match action {
        Action::SetModeOffboard => Request::SetMode(FlightMode::Offboard),
        Action::SetModeHold => Request::SetMode(FlightMode::Hold),
        Action::SetModeLand => Request::SetMode(FlightMode::Land),
        Action::Arm => Request::Arm,
        Action::Disarm => Request::Disarm,
    }
}

/// Every action.
const ACTIONS: [Action; 5] = [
    Action::SetModeOffboard,
    Action::SetModeHold,
    Action::SetModeLand,
    Action::Arm,
    Action::Disarm,
];

/// The action behind a request, if the offboard controller made it.
fn action_of(request: &Request) -> Option<Action> {
    ACTIONS.into_iter().find(|action| request_of(*action) == *request)
}

impl Station {
    pub(super) fn request_ended(&mut self, now: HostTime, request: &Request, outcome: &Outcome) {
        if let Request::ReadParameter(name) = request
            && self.profile.as_ref().is_some_and(|profile| log_parameters(profile).contains(name))
        {
            // No vehicle has all of these parameters.
            if let (Outcome::Parameter(value), None) = (outcome, &self.end) {
                let fact = (format!("{PARAMETER_FACT}{name}"), value.to_string());
                self.records.push(Record::Facts(Box::new([fact].into())));
            }
            return;
        }
        if let (Request::ReadParameter(name), Outcome::Parameter(value)) = (request, outcome) {
            self.check_standing(now);
            let rule = self.profile.as_ref().and_then(|profile| profile.loss_timeout);
            if let Some(rule) = rule.filter(|rule| rule.name == name && !rule.holds(*value)) {
                let text =
                    format!("parameter {name} is {value}: {}; set it to {}", rule.why, rule.rule);
                self.report(now, Severity::Notice, text);
            }
            return;
        }
        if matches!(
            outcome,
            Outcome::Done | Outcome::Parameter(_) | Outcome::Superseded | Outcome::Withdrawn
        ) {
            return;
        }
        // An autopilot has only some of these parameters, depending on its version.
        if let (Request::ReadParameter(name), Some(profile)) = (request, &self.profile)
            && profile.loss.parameters().contains(&name.as_str())
        {
            return;
        }
        let warning = self.offboard.as_ref().and_then(|offboard| {
            let (at, text) = offboard.telemetry().status().warning.as_ref()?;
            (now.since(*at).as_secs_f64() < 3.0).then(|| text.clone())
        });
        let text = match warning {
            Some(warning) => format!("{outcome}: {warning}"),
            None => outcome.to_string(),
        };
        let action = action_of(request);
        match (action, &mut self.offboard) {
            (Some(action), Some(offboard)) => {
                offboard.link_event(now, LinkEvent::Refused { action, text });
            }
            _ => self.report(now, Severity::Notice, format!("{request:?}: {text}")),
        }
    }
}
