//! Reading a network from a model file's tensors.

use safetensors::SafeTensors;
use safetensors::tensor::{Dtype, TensorView};

use crate::model::features::{FEATURES_MAX, OUTPUTS};
use crate::model::learned::Network;
use crate::model::net::{Mlp, Normalization};

/// Most hidden units.
const HIDDEN_MAX: usize = 4096;

/// The tensors of one network in a model file.
pub(super) struct NetworkTensors<'a> {
    pub tensors: &'a SafeTensors<'a>,
    /// Start of their names.
    pub prefix: String,
}

impl NetworkTensors<'_> {
    fn name(&self, part: &str) -> String {
        format!("{}.{part}", self.prefix)
    }

    fn view(&self, part: &str, kind: Dtype) -> Result<TensorView<'_>, String> {
        let name = self.name(part);
        let view = self.tensors.tensor(&name).map_err(|error| format!("tensor {name}: {error}"))?;
        if view.dtype() != kind {
            return Err(format!("tensor {name}: expected {kind:?}, found {:?}", view.dtype()));
        }
        Ok(view)
    }

    fn doubles(&self, part: &str, length: usize) -> Result<Vec<f64>, String> {
        let view = self.view(part, Dtype::F64)?;
        let values: Vec<f64> =
            view.data().as_chunks().0.iter().map(|bytes| f64::from_le_bytes(*bytes)).collect();
        let (found, finite) = (values.len(), values.iter().filter(|v| v.is_finite()).count());
        let sound = [found, finite] == [length; 2];
        sound.then_some(values).ok_or_else(|| {
            let name = self.name(part);
            format!("tensor {name}: expected {length} finite numbers, found {finite} among {found}")
        })
    }

    fn singles(&self, part: &str, shape: &[usize]) -> Result<Vec<f32>, String> {
        let view = self.view(part, Dtype::F32)?;
        if view.shape() != shape {
            let name = self.name(part);
            return Err(format!("tensor {name}: expected {shape:?}, found {:?}", view.shape()));
        }
        let values: Vec<f32> =
            view.data().as_chunks().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect();
        let odd = values.iter().copied().find(|v| !v.is_finite());
        odd.map_or(Ok(values), |odd| {
            Err(format!("tensor {}: expected finite numbers, found {odd}", self.name(part)))
        })
    }

    fn normalization(&self, side: &str, length: usize) -> Result<Normalization, String> {
        let deviation = self.doubles(&format!("{side}_deviation"), length)?;
        if deviation.iter().any(|d| *d <= 0.0) {
            return Err(format!("tensor {}: expected numbers above 0", self.name(side)));
        }
        Ok(Normalization { mean: self.doubles(&format!("{side}_mean"), length)?, deviation })
    }

    /// The network, which has `inputs` features.
    pub fn network(&self, inputs: usize) -> Result<Network, String> {
        debug_assert!(inputs <= FEATURES_MAX);
        let hidden = self.view("hidden.bias", Dtype::F32)?.shape().iter().product();
        if !(1..=HIDDEN_MAX).contains(&hidden) {
            return Err(format!("expected 1 to {HIDDEN_MAX} hidden units, found {hidden}"));
        }
        Ok(Network {
            inputs: self.normalization("input", inputs)?,
            outputs: self.normalization("output", OUTPUTS)?,
            mlp: Mlp {
                inputs,
                hidden,
                outputs: OUTPUTS,
                hidden_weights: self.singles("hidden.weight", &[hidden, inputs])?,
                hidden_biases: self.singles("hidden.bias", &[hidden])?,
                output_weights: self.singles("output.weight", &[OUTPUTS, hidden])?,
                output_biases: self.singles("output.bias", &[OUTPUTS])?,
            },
        })
    }
}
