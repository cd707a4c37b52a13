//! The link to a vehicle: connection, codec, session, time synchronisation, counters.
//!
//! A [`connection::Connection`] keeps an endpoint open and moves bytes. A [`session::Session`] is
//! the protocol, sans I/O. One loop drives both:
//!
//! ```no_run
//! # use downwash::clock::HostTime;
//! # use downwash::link::connection::{Connection, Input};
//! # use downwash::link::session::{Delivery, Session};
//! # use std::time::Duration;
//! # async fn drive(mut connection: Connection, mut session: Session, clock: fn() -> HostTime) {
//! let mut buffer = vec![0; wire::transport::RECEIVE_LEN];
//! loop {
//!     let wait = session.next_deadline().since(clock());
//!     let input = tokio::time::timeout(wait, connection.recv(&mut buffer)).await;
//!     let now = clock();
//!     match input {
//!         Ok(Input::Bytes { peer, len }) => {
//!             let is_datagram = connection.is_datagram();
//!             session.receive(now, peer, &buffer[..len], is_datagram, &mut |it| match it {
//!                 Delivery::Frame { .. } => {} // to the log
//!                 Delivery::Replaced => {} // to the controller, which ends its flight
//!                 Delivery::Message(_) => {} // for the controller, whose setpoint goes out below
//!             });
//!         }
//!         Ok(Input::PeerClosed(peer)) => {
//!             session.peer_closed(peer);
//!         }
//!         Ok(Input::Lost(_)) => session.transport_closed(),
//!         Ok(Input::Opened | Input::Failed { .. } | Input::PeerOpened(_)) | Err(_) => {}
//!     }
//!     session.poll(now);
//!     session.transmit(|to, frame| connection.send(to, frame));
//!     while let Some(_event) = session.next_event() {} // to the log and the supervisor
//! }
//! # }
//! ```

mod arrival;
pub mod attitude_target;
pub mod budget;
mod clock_estimate;
pub mod connection;
pub mod counters;
pub mod external_pose;
pub mod intervals;
pub mod load;
pub mod loss_reaction;
mod mode_reports;
pub mod profile;
pub mod received;
pub mod request;
mod sequence;
pub mod session;
pub mod several;
pub mod signing;
pub mod silence;
pub mod tee;
pub mod timesync;
pub mod vehicle_clock;
