//! Kinds of flight in a programme.

use schemars::JsonSchema;
use serde::Serialize;

/// The axes and the pattern of a flight.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, JsonSchema, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum FlightKind {
    /// North and east.
    SinusoidXy,
    /// North and height.
    SinusoidXz,
    /// East and height.
    SinusoidYz,
    /// Yaw alone.
    YawRotation,
    /// All three axes, over a band of frequencies.
    Unstructured,
    /// North, east and yaw: reserved for testing the model.
    CombinedSinusoidYaw,
    /// A figure 8 with yaw motion.
    #[serde(rename = "combined-figure-8")]
    CombinedFigureEight,
    /// All three axes and yaw.
    CombinedUnstructured,
}

impl FlightKind {
    /// The name in logs and file names.
    pub fn name(self) -> &'static str {
        match self {
            Self::SinusoidXy => "sinusoid-xy",
            Self::SinusoidXz => "sinusoid-xz",
            Self::SinusoidYz => "sinusoid-yz",
            Self::YawRotation => "yaw-rotation",
            Self::Unstructured => "unstructured",
            Self::CombinedSinusoidYaw => "combined-sinusoid-yaw",
            Self::CombinedFigureEight => "combined-figure-8",
            Self::CombinedUnstructured => "combined-unstructured",
        }
    }

    /// Whether it moves north, east and vertically.
    pub(super) fn axes(self) -> [bool; 3] {
        match self {
            Self::SinusoidXy | Self::CombinedSinusoidYaw | Self::CombinedFigureEight => {
                [true, true, false]
            }
            Self::SinusoidXz => [true, false, true],
            Self::SinusoidYz => [false, true, true],
            Self::YawRotation => [false; 3],
            Self::Unstructured | Self::CombinedUnstructured => [true; 3],
        }
    }

    pub(super) fn turns(self) -> bool {
        matches!(
            self,
            Self::YawRotation
                | Self::CombinedSinusoidYaw
                | Self::CombinedFigureEight
                | Self::CombinedUnstructured
        )
    }
}
