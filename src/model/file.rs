//! The model file: weights as safetensors, everything else in its metadata.

mod network_tensors;

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use safetensors::tensor::{Dtype, TensorView};
use safetensors::{SafeTensorError, SafeTensors};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use vehicle::bounded;
use vehicle::{Difference, VehicleError, VehicleParams};

use self::network_tensors::NetworkTensors;
use super::actuation::Actuation;
use super::features::{Features, Head};
use super::hybrid::Hybrid;
use super::learned::{Network, NetworkModel};
use super::physics::{PhysicsModel, PhysicsParameters};
use super::{ACCELERATIONS, Model};

/// Identifier in the file's `format` field.
const FORMAT: &str = "downwash.model";
/// Version of the file format; files of other versions are rejected.
const VERSION: u32 = 1;
/// The one key of the metadata: a JSON object.
const KEY: &str = "downwash";
/// Largest file, in bytes: room for networks with the most hidden units and their training record.
const SIZE_MAX: u64 = 64 << 20;

/// One of a file's models.
#[derive(
    Clone,
    Copy,
    Debug,
    PartialEq,
    Eq,
    PartialOrd,
    Ord,
    JsonSchema,
    Serialize,
    Deserialize,
    clap::ValueEnum,
)]
#[serde(rename_all = "lowercase")]
pub enum ModelKind {
    /// The two networks alone.
    Net,
    /// The fitted physics alone.
    Physics,
    /// The physics plus networks on its residual.
    Hybrid,
}

impl ModelKind {
    /// All, in the order of tables.
    pub const ALL: [ModelKind; 3] = [ModelKind::Net, ModelKind::Physics, ModelKind::Hybrid];

    /// Its name in files and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            ModelKind::Net => "net",
            ModelKind::Physics => "physics",
            ModelKind::Hybrid => "hybrid",
        }
    }
}

/// The source of the linear acceleration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum AccelerationSource {
    /// The accelerometer, rotated to the world, plus gravity; the velocity removes its bias.
    SpecificForce,
    /// The slope of the velocity.
    VelocitySlope,
}

impl AccelerationSource {
    /// Its name for people.
    pub fn name(self) -> &'static str {
        match self {
            AccelerationSource::SpecificForce => "specific force",
            AccelerationSource::VelocitySlope => "slope of the velocity",
        }
    }
}

/// A model file, in memory.
#[derive(Clone, Debug, PartialEq)]
pub struct ModelFile {
    /// The vehicle that it was trained for.
    pub vehicle: VehicleParams,
    /// The rotors' response.
    pub actuation: Actuation,
    /// Source of the linear acceleration in the labels.
    pub acceleration: AccelerationSource,
    /// Standard deviation of the labels over the training rows: the unit of normalised errors.
    pub deviation: [f64; ACCELERATIONS],
    /// The networks.
    pub net: NetworkModel,
    /// The physics' parameters.
    pub physics: PhysicsParameters,
    /// The networks on the residual of the physics.
    pub residual: NetworkModel,
    /// The model with the smallest errors on the validation data.
    pub preferred: ModelKind,
    /// How it was trained: logs with hashes, split, settings, errors.
    pub training: serde_json::Value,
}

/// Why a model file is rejected.
#[derive(Debug, thiserror::Error)]
pub enum ModelFileError {
    /// The file cannot be read or written.
    #[error("model file {}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
    },
    /// Text, such as a vehicle file.
    #[error(
        "model file {}: expected a file that `downwash train` wrote, found text; \
         --vehicle takes a vehicle file",
        path.display()
    )]
    Text {
        /// The file.
        path: PathBuf,
    },
    /// Not a model file, or a damaged one.
    #[error("model file {}: {reason}; train it again or copy it again", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// Written by another version.
    #[error(
        "model file {}: expected format version {VERSION}, found {found}; train it again with this \
         version",
        path.display()
    )]
    Version {
        /// The file.
        path: PathBuf,
        /// Its version.
        found: u32,
    },
    /// For another vehicle.
    #[error(
        "model file {}: it was trained for the vehicle {trained:?}, which differs from this one: \
         {difference}. Train a model for this vehicle",
        path.display()
    )]
    Vehicle {
        /// The file.
        path: PathBuf,
        /// Name of the vehicle that it was trained for.
        trained: String,
        /// The first difference.
        difference: Box<Difference>,
    },
    /// Its vehicle is invalid.
    #[error(transparent)]
    Physics(#[from] VehicleError),
}

#[derive(Serialize, Deserialize)]
struct Header {
    format: String,
    version: u32,
    tool_version: String,
    frames: String,
    units: String,
    vehicle: VehicleParams,
    features: Features,
    residual_features: Features,
    feature_names: [Vec<String>; 2],
    actuation: Actuation,
    acceleration: AccelerationSource,
    deviation: [f64; ACCELERATIONS],
    physics: PhysicsParameters,
    preferred: ModelKind,
    training: serde_json::Value,
    /// SHA-256 of this header with this field empty, then of the tensors' names and bytes, in the
    /// order of the names.
    sha256: String,
}

impl Header {
    /// The value that `sha256` must have.
    fn seal<'a>(
        &self,
        tensors: impl Iterator<Item = (&'a str, &'a [u8])>,
    ) -> serde_json::Result<String> {
        let mut hash = Sha256::new();
        hash.update(serde_json::to_vec(self)?);
        for (name, bytes) in tensors {
            hash.update(name);
            hash.update((bytes.len() as u64).to_le_bytes());
            hash.update(bytes);
        }
        Ok(hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect())
    }
}

impl ModelFile {
    /// One of the file's models, ready for evaluation.
    ///
    /// # Errors
    /// The vehicle does not allow the physics.
    pub fn model(&self, kind: ModelKind) -> Result<Box<dyn Model>, VehicleError> {
        let physics = PhysicsModel::new(&self.vehicle, &self.physics)?;
        Ok(match kind {
            ModelKind::Net => Box::new(self.net.clone()),
            ModelKind::Physics => Box::new(physics),
            ModelKind::Hybrid => Box::new(Hybrid::new(physics, self.residual.clone())),
        })
    }

    /// The file's bytes. Equal models give equal bytes.
    ///
    /// # Errors
    /// The header cannot be written.
    pub fn to_bytes(&self) -> Result<Vec<u8>, SafeTensorError> {
        let tensors = self.tensors();
        let mut header = Header {
            format: FORMAT.to_owned(),
            version: VERSION,
            tool_version: env!("CARGO_PKG_VERSION").to_owned(),
            frames: "world NED, body FRD, angles roll pitch yaw (z-y-x)".to_owned(),
            units: "SI, rad".to_owned(),
            vehicle: self.vehicle.clone(),
            features: self.net.features,
            residual_features: self.residual.features,
            feature_names: Head::BOTH
                .map(|head| self.net.features.names(head).into_iter().map(str::to_owned).collect()),
            actuation: self.actuation,
            acceleration: self.acceleration,
            deviation: self.deviation,
            physics: self.physics.clone(),
            preferred: self.preferred,
            training: self.training.clone(),
            sha256: String::new(),
        };
        let text = header
            .seal(tensors.iter().map(|t| (t.name.as_str(), t.bytes.as_slice())))
            .and_then(|seal| {
                header.sha256 = seal;
                serde_json::to_string(&header)
            })
            .map_err(SafeTensorError::InvalidHeaderDeserialization)?;
        let views = tensors
            .iter()
            .map(|t| Ok((t.name.as_str(), TensorView::new(t.kind, t.shape.clone(), &t.bytes)?)))
            .collect::<Result<Vec<_>, SafeTensorError>>()?;
        safetensors::serialize(views, Some(HashMap::from([(KEY.to_owned(), text)])))
    }

    fn tensors(&self) -> Vec<Tensor> {
        let mut tensors = Vec::new();
        for (prefix, model) in [("net", &self.net), ("residual", &self.residual)] {
            for (head, network) in [(Head::Linear, &model.linear), (Head::Angular, &model.angular)]
            {
                let name = |part: &str| format!("{prefix}.{}.{part}", head.name());
                let Network { inputs, outputs, mlp } = network;
                tensors.extend([
                    Tensor::doubles(name("input_mean"), &inputs.mean),
                    Tensor::doubles(name("input_deviation"), &inputs.deviation),
                    Tensor::doubles(name("output_mean"), &outputs.mean),
                    Tensor::doubles(name("output_deviation"), &outputs.deviation),
                    Tensor::singles(
                        name("hidden.weight"),
                        &[mlp.hidden, mlp.inputs],
                        &mlp.hidden_weights,
                    ),
                    Tensor::singles(name("hidden.bias"), &[mlp.hidden], &mlp.hidden_biases),
                    Tensor::singles(
                        name("output.weight"),
                        &[mlp.outputs, mlp.hidden],
                        &mlp.output_weights,
                    ),
                    Tensor::singles(name("output.bias"), &[mlp.outputs], &mlp.output_biases),
                ]);
            }
        }
        tensors.sort_by(|a, b| a.name.cmp(&b.name));
        tensors
    }

    /// Reads and checks a model file.
    ///
    /// # Errors
    /// [`ModelFileError`].
    pub fn load(path: &Path) -> Result<Self, ModelFileError> {
        let bytes = bounded::read(path, SIZE_MAX)
            .map_err(|source| ModelFileError::Io { path: path.to_owned(), source })?;
        Self::from_bytes(&bytes, path)
    }

    /// Parses a model file from its bytes; `path` is for messages.
    ///
    /// # Errors
    /// [`ModelFileError`].
    pub fn from_bytes(bytes: &[u8], path: &Path) -> Result<Self, ModelFileError> {
        let damaged = |reason: String| ModelFileError::Damaged { path: path.to_owned(), reason };
        let (_, metadata) = SafeTensors::read_metadata(bytes).map_err(|error| {
            if is_text(bytes) {
                return ModelFileError::Text { path: path.to_owned() };
            }
            damaged(format!("not a safetensors file ({error})"))
        })?;
        let text = metadata
            .metadata()
            .as_ref()
            .and_then(|map| map.get(KEY))
            .ok_or_else(|| damaged(format!("its metadata has no key {KEY:?}")))?;
        check_stamp(text, path)?;
        let mut header: Header = serde_json::from_str(text)
            .map_err(|error| damaged(format!("its metadata is corrupt ({error})")))?;
        let tensors = SafeTensors::deserialize(bytes)
            .map_err(|error| damaged(format!("its tensors cannot be read ({error})")))?;
        let mut named = tensors.tensors();
        named.sort_by(|a, b| a.0.cmp(&b.0));
        let stated = std::mem::take(&mut header.sha256);
        let found = header
            .seal(named.iter().map(|(name, view)| (name.as_str(), view.data())))
            .map_err(|error| damaged(error.to_string()))?;
        if found != stated {
            return Err(damaged("its content does not match its checksum".to_owned()));
        }
        let model = |prefix: &str, features: Features| {
            let network = |head: Head| {
                let prefix = format!("{prefix}.{}", head.name());
                NetworkTensors { tensors: &tensors, prefix }.network(features.names(head).len())
            };
            Ok::<_, String>(NetworkModel {
                features,
                linear: network(Head::Linear)?,
                angular: network(Head::Angular)?,
            })
        };
        Ok(Self {
            net: model("net", header.features).map_err(damaged)?,
            residual: model("residual", header.residual_features).map_err(damaged)?,
            vehicle: header.vehicle.checked()?,
            actuation: header.actuation,
            acceleration: header.acceleration,
            deviation: header.deviation,
            physics: header.physics,
            preferred: header.preferred,
            training: header.training,
        })
    }

    /// Checks that this model is for `vehicle`, with [`VehicleParams::difference`]. `path` is for
    /// the message.
    ///
    /// # Errors
    /// [`ModelFileError::Vehicle`] with the first difference.
    pub fn check_vehicle(
        &self,
        vehicle: &VehicleParams,
        path: &Path,
    ) -> Result<(), ModelFileError> {
        match vehicle.difference(&self.vehicle) {
            None => Ok(()),
            Some(difference) => Err(ModelFileError::Vehicle {
                path: path.to_owned(),
                trained: self.vehicle.name.clone(),
                difference: Box::new(difference),
            }),
        }
    }
}

/// Checks format and version, before the rest is read: another version may have another header.
fn check_stamp(text: &str, path: &Path) -> Result<(), ModelFileError> {
    #[derive(Deserialize)]
    struct Stamp {
        format: String,
        version: u32,
    }
    let damaged = |reason: String| ModelFileError::Damaged { path: path.to_owned(), reason };
    let Stamp { format, version } = serde_json::from_str(text)
        .map_err(|error| damaged(format!("its metadata is corrupt ({error})")))?;
    if format != FORMAT {
        return Err(damaged(format!("expected the format {FORMAT:?}, found {format:?}")));
    }
    if version != VERSION {
        return Err(ModelFileError::Version { path: path.to_owned(), found: version });
    }
    Ok(())
}

struct Tensor {
    name: String,
    kind: Dtype,
    shape: Vec<usize>,
    bytes: Vec<u8>,
}

impl Tensor {
    fn doubles(name: String, values: &[f64]) -> Self {
        let bytes = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        Self { name, kind: Dtype::F64, shape: vec![values.len()], bytes }
    }

    fn singles(name: String, shape: &[usize], values: &[f32]) -> Self {
        let bytes = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        Self { name, kind: Dtype::F32, shape: shape.to_vec(), bytes }
    }
}

/// Whether bytes are text. A model file begins with a length of 8 bytes, some of them zero.
fn is_text(bytes: &[u8]) -> bool {
    bytes.len() >= 8 && !bytes.contains(&0) && std::str::from_utf8(bytes).is_ok()
}

#[cfg(test)]
mod tests;
