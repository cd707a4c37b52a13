//! The faults of a room's poses, and their counts.

use std::fmt;

use schemars::JsonSchema;
use serde::Serialize;

/// Declares each fault once: its name, its JSON key with what it counts, and its message with the
/// cure.
macro_rules! faults {
    ($($name:ident, $key:ident: $counts:literal, $words:literal;)+) => {
        /// Why a pose is not forwarded.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
        pub enum Fault { $(#[doc = $counts] $name,)+ }

        impl fmt::Display for Fault {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str(match self { $(Self::$name => $words,)+ })
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
    Malformed, malformed: "Lines or packets that are not as the protocol says.",
        "what the room sends is not as its protocol says; compare it with docs/mocap.md, and \
         mocap.natnet_version with Motive's";
    NotANumber, not_a_number: "Poses with a number that is none.",
        "the room sends NaN or infinity; a body that is not seen is to be sent with \"tracked\": false, or \
         not at all";
    NotAUnit, not_a_unit: "Poses whose quaternion is not of length 1.",
        "the room sends a quaternion whose length is not 1; check the sender, and that it sends w, x, y, z";
    NotTracked, not_tracked: "Poses of a body that the room says it does not see.",
        "the room does not see the body; check its markers, and what hides them";
    OutOfOrder, out_of_order: "Poses that are not newer than the one before.",
        "frames come out of order or twice; check for two senders on this port";
    Ahead, ahead: "Poses with a stamp from the future.",
        "the room's clock was set forward; it is taken anew once it has run steadily";
    Old, old: "Poses that are too old.",
        "frames come late; check the network (cable, no Wi-Fi) and the room computer's load; where its \
         clock was set back, start this again";
    Frozen, frozen: "The same pose again, under a new stamp.",
        "the room repeats one pose: the tracker hangs, or rounds; restart it, and have it send every digit";
    Jumped, jumped: "Poses where the body cannot be so soon.",
        "the body jumped: the tracker took something else for it; check its markers, and for reflections";
    Swapped, swapped: "Poses where another body is.",
        "the body is where another one was: the tracker swapped the two; make their markers differ, and name \
         them right";
    Silent, silent: "Times when nothing was heard of the body.",
        "nothing is heard of the body any more; check that the room still streams, and that it sees the body";
    Settling, settling: "Poses after a fault or at the start, before the body was believed.",
        "the body comes, and is not believed yet";
}
