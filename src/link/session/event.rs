//! What a session delivers: frames and messages as they arrive, and news.

use std::time::Duration;

use wire::transport::Peer;

use super::VehicleId;
use crate::link::budget::LineBudget;
use crate::link::counters::LinkState;
use crate::link::intervals::IntervalEvent;
use crate::link::profile::Profile;
use crate::link::received::Received;
use crate::link::request::{Outcome, Request, RequestId};
use crate::link::signing::FrameRejection;

/// What [`Session::receive`](super::Session::receive) delivers, in order of arrival.
#[derive(Debug)]
pub enum Delivery<'a> {
    /// A frame of any sender, as it was on the wire.
    Frame {
        /// The peer that sent it.
        peer: Peer,
        /// The whole frame.
        bytes: &'a [u8],
    },
    /// From here on a different vehicle answers under the ids of the known one.
    /// [`Event::VehicleReplaced`] reports it afterwards.
    Replaced,
    /// A message from the vehicle.
    Message(Received),
}

/// News of the session.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// The link's state changed.
    State {
        /// Old state.
        from: LinkState,
        /// New state.
        to: LinkState,
    },
    /// A vehicle was found, for the first time or again after it was lost.
    VehicleFound(VehicleId),
    /// A second autopilot appeared, and nothing decides which one is meant.
    AnotherAutopilot {
        /// The first one.
        vehicle: VehicleId,
        /// The second one.
        other: VehicleId,
    },
    /// The HEARTBEAT shows that a different vehicle answers under the known ids. It is identified
    /// before it gets setpoints, and requests to the former vehicle end.
    VehicleReplaced(VehicleId),
    /// The vehicle is identified and can get setpoints.
    Identified {
        /// Its profile.
        profile: Box<Profile>,
        /// Whether it answered with its version.
        is_version_known: bool,
    },
    /// A request ended.
    Request {
        /// Its id.
        id: RequestId,
        /// The request.
        request: Request,
        /// How it ended.
        outcome: Outcome,
    },
    /// News of a message interval.
    Interval(IntervalEvent),
    /// The wanted messages need more of the serial line than it can carry reliably.
    LineBudget(Box<LineBudget>),
    /// The vehicle answered a TIMESYNC request after this round trip.
    RoundTrip(Duration),
    /// The vehicle answered a TIMESYNC request again this long after its first answer: the link
    /// carried the request to it twice.
    RequestAgain(Duration),
    /// The vehicle's clock jumped. A jump beyond a second, in either direction, may mean another
    /// vehicle, so it is identified again before it gets setpoints.
    ClockJump {
        /// Size of the jump, ns.
        by_ns: i64,
    },
    /// A frame was rejected, for a new reason.
    FrameRejected(FrameRejection),
}
