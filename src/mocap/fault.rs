//! The faults of a room's poses, and their counts.

use std::fmt;

use schemars::JsonSchema;
use serde::Serialize;

/// Declares each fault once: its name, its JSON key with what it counts, and its message with the
/// cure.
macro_rules! faults {
    ($($name:ident, $key:ident: $counts:literal, $text:literal;)+) => {
        /// Why a pose is not forwarded.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
        pub enum Fault { $(#[doc = $counts] $name,)+ }

        impl fmt::Display for Fault {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str(match self { $(Self::$name => $text,)+ })
            }
        }

        /// Poses and datagrams that were not forwarded, by reason.
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, JsonSchema, Serialize)]
        pub struct FaultCounts { $(#[doc = $counts] pub $key: u64,)+ }

        impl FaultCounts {
            /// Counts one occurrence.
            pub fn count(&mut self, fault: Fault) {
                *match fault { $(Fault::$name => &mut self.$key,)+ } += 1;
            }

            /// The number of occurrences.
            pub fn of(&self, fault: Fault) -> u64 {
                match fault { $(Fault::$name => self.$key,)+ }
            }
        }
    };
}

faults! {
    Malformed, malformed: "Lines or packets that violate the protocol.",
        "the room's data violates its protocol; compare it with docs/mocap.md, and \
         mocap.natnet_version with Motive's";
    NotANumber, not_a_number: "Poses with a value that is not finite.",
        "the room sends NaN or infinity; have it send an unseen body with \"tracked\": false, or \
         not at all";
    NotAUnit, not_a_unit: "Poses whose quaternion is not of length 1.",
        "the room sends a quaternion whose length is not 1; check the sender, and that it sends w, x, y, z";
    NotTracked, not_tracked: "Poses of a body that the room says it does not see.",
        "the room does not see the body; check its markers, and what hides them";
    OutOfOrder, out_of_order: "Poses that are not newer than the one before.",
        "frames arrive out of order or twice; check for two senders on this port";
    Ahead, ahead: "Poses with a stamp from the future.",
        "the room's clock was set forward; its offset is estimated again once it has run steadily";
    Old, old: "Poses that are too old.",
        "frames arrive late; check the network (cable, no Wi-Fi) and the room computer's load; if \
         its clock was set back, restart this program";
    Frozen, frozen: "The same pose again, under a new stamp.",
        "the room repeats one pose: the tracker hangs, or rounds; restart it, and have it send every digit";
    Jumped, jumped: "Poses that the body cannot have reached so soon.",
        "the body jumped: the tracker mistook something else for it; check its markers, and look \
         for reflections";
    Swapped, swapped: "Poses at another body's place.",
        "the body is where another one was: the tracker swapped the two; make their markers \
         differ, and name them correctly";
    Silent, silent: "Times when no pose of the body arrived.",
        "no pose of the body arrives any more; check that the room still streams, and that it sees \
         the body";
    Settling, settling: "Poses after a fault or at the start, not yet accepted.",
        "poses of the body arrive, and are not accepted yet";
}
