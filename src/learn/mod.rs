//! From flight logs to a model: dataset, features, training, validation.
