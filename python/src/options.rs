//! Keyword arguments as the library's options: every flag of a verb is a keyword of the same name
//! with underscores, and takes the values that its key of the configuration takes.

use crate::said::usage;
use clap::{Args, Command};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value};

/// Keywords that nobody has taken yet.
pub(crate) struct Keywords<'py> {
    py: Python<'py>,
    call: &'static str,
    left: Map<String, Value>,
    known: Vec<String>,
}

impl<'py> Keywords<'py> {
    /// The keywords of a call.
    pub(crate) fn new(
        py: Python<'py>,
        call: &'static str,
        given: Option<&Bound<'py, PyDict>>,
    ) -> PyResult<Self> {
        let left = given.map_or_else(|| Ok(Map::new()), |d| pythonize::depythonize(d.as_any()))?;
        Ok(Self {
            py,
            call,
            left,
            known: Vec::new(),
        })
    }

    /// Options of which all flags may be given.
    pub(crate) fn take<T: Args + DeserializeOwned>(&mut self) -> PyResult<T> {
        let flags = T::augment_args(Command::new(self.call));
        let names: Vec<&str> = flags.get_arguments().map(|a| a.get_id().as_str()).collect();
        self.take_only(&names)
    }

    /// Options of which those named may be given; the others keep their defaults.
    pub(crate) fn take_only<T: DeserializeOwned>(&mut self, names: &[&str]) -> PyResult<T> {
        let mut taken = Map::new();
        for name in names {
            self.known.push((*name).to_owned());
            let Some(value) = self.left.remove(*name) else {
                continue;
            };
            let key = name.replace('_', "-");
            taken.insert(key.clone(), self.understood::<T>(name, &key, value)?);
        }
        self.made(taken).map_err(|e| self.wrong(&e.to_string()))
    }

    /// The value of a key as the options take it: `True` and `False` are also a switch's on and off.
    fn understood<T: DeserializeOwned>(
        &self,
        name: &str,
        key: &str,
        value: Value,
    ) -> PyResult<Value> {
        let alone = |v: &Value| self.made::<T>(Map::from_iter([(key.to_owned(), v.clone())]));
        let Err(e) = alone(&value) else {
            return Ok(value);
        };
        if let Value::Bool(on) = value {
            let word = Value::from(if on { "on" } else { "off" });
            if alone(&word).is_ok() {
                return Ok(word);
            }
        }
        Err(self.wrong(&format!("{name}={value}: {e}")))
    }

    fn made<T: DeserializeOwned>(&self, map: Map<String, Value>) -> serde_json::Result<T> {
        serde_json::from_value(Value::Object(map))
    }

    fn wrong(&self, message: &str) -> PyErr {
        usage(self.py, format!("{}: {message}", self.call))
    }

    /// Refuses what nobody took.
    pub(crate) fn finish(self) -> PyResult<()> {
        match self.left.keys().next() {
            None => Ok(()),
            Some(name) => Err(self.wrong(&format!(
                "there is no option {name}; options are {}",
                self.known.join(", ")
            ))),
        }
    }
}
