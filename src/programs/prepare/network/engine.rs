//! Runs an ONNX file by tract: one image in, one map out. The shape of the input is found in the
//! file: NCHW with three channels, height and width stated or free. Called by `model`.

use super::engine_types::{Output, Shape};
use crate::core::formats::{MOST_DATA, read_input};
use crate::error::{Error, Result};
use std::collections::{BTreeMap, BTreeSet};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use tract_onnx::pb::ModelProto;
use tract_onnx::prelude::*;
use tract_onnx::tract_hir::infer::Factoid;
use tract_onnx::tract_hir::internal::DimLike;

/// A network as its file has it.
pub(super) struct Engine {
    path: PathBuf,
    model: InferenceModel,
    /// Side of the input, where the file states it.
    pub shape: Shape,
    /// The file's `metadata_props`.
    pub properties: BTreeMap<String, String>,
}

/// A network for images of one size.
pub(super) struct Plan {
    path: PathBuf,
    model: TypedRunnableModel<TypedModel>,
    size: [usize; 2],
}

impl Engine {
    /// Reads a network.
    ///
    /// # Errors
    /// A file that is no ONNX, has more than an image in or a map out, another layout than NCHW in
    /// float32, or an operator that tract lacks.
    pub fn load(path: &Path) -> Result<Self> {
        let bytes = read_input(path, MOST_DATA)?;
        let proto = onnx().proto_model_for_read(&mut bytes.as_slice());
        let proto = proto.ok().filter(|p| p.graph.is_some()).ok_or_else(|| {
            Error::input(
                path,
                "is no ONNX file; expected what torch.onnx.export or another exporter writes (.onnx)",
            )
        })?;
        lacking(path, &proto)?;
        let folder = path.parent().and_then(Path::to_str);
        let parsed = guarded(path, || onnx().parse(&proto, folder))?;
        let model = parsed.model;
        let shape = input_shape(path, &model)?;
        let outputs = model.outputs.len();
        if outputs != 1 {
            return Err(Error::input(
                path,
                format!(
                    "has {outputs} outputs; expected one, the depth or the classes. Export the network with that output alone"
                ),
            ));
        }
        let properties = proto.metadata_props.iter();
        Ok(Self {
            path: path.to_path_buf(),
            shape,
            properties: properties
                .map(|p| (p.key.clone(), p.value.clone()))
                .collect(),
            model,
        })
    }

    /// The network for images of `size`, columns and rows.
    ///
    /// # Errors
    /// Where its layers do not fit images of that size.
    pub fn plan(&self, size: [usize; 2]) -> Result<Plan> {
        let fact = f32::fact([1, 3, size[1], size[0]]);
        let model = guarded(&self.path, || {
            let model = self.model.clone().with_input_fact(0, fact.into())?;
            model.into_optimized()?.into_runnable()
        })?;
        Ok(Plan {
            path: self.path.clone(),
            model,
            size,
        })
    }
}

impl Plan {
    /// The map of an image: three planes of pixels, each row by row.
    ///
    /// # Errors
    /// Where the network fails, or gives something else than a map.
    pub fn run(&self, planes: &[f32]) -> Result<Output> {
        let shape = [1, 3, self.size[1], self.size[0]];
        let given = guarded(&self.path, || {
            let input = Tensor::from_shape(&shape, planes)?;
            let mut given = self.model.run(tvec!(input.into()))?;
            Ok(given.swap_remove(0).into_tensor())
        })?;
        let integers = given.datum_type().is_integer() || given.datum_type() == bool::datum_type();
        let values = guarded(&self.path, || {
            Ok(given.cast_to::<f32>()?.as_slice::<f32>()?.to_vec())
        })?;
        // the batch of one goes; what is left is a map, or a map for each channel
        let shape: Vec<usize> = match given.shape() {
            [1, rest @ ..] if rest.len() >= 2 => rest.to_vec(),
            all => all.to_vec(),
        };
        let [channels, height, width] = match shape[..] {
            [h, w] => [1, h, w],
            [c, h, w] => [c, h, w],
            _ => [0; 3],
        };
        if channels * height * width == 0 {
            return Err(Error::input(
                &self.path,
                format!(
                    "gives {:?}; expected a map: 1 x channels x rows x columns",
                    given.shape()
                ),
            ));
        }
        Ok(Output {
            size: [width, height],
            channels,
            values,
            integers,
        })
    }
}

/// Refuses operators that tract does not know, all of them at once.
fn lacking(path: &Path, proto: &ModelProto) -> Result<()> {
    let known = onnx().op_register.0;
    let nodes = proto.graph.iter().flat_map(|g| &g.node);
    let missing: BTreeSet<&str> = nodes
        .map(|n| n.op_type.as_str())
        .filter(|t| !known.contains_key(*t))
        .collect();
    if missing.is_empty() {
        return Ok(());
    }
    let list: Vec<&str> = missing.into_iter().collect();
    Err(Error::input(
        path,
        format!(
            "needs operators that the runtime (tract) lacks: {}. Export with another opset (torch.onnx.export(…, opset_version=17)), or simplify the file (onnxsim)",
            list.join(", ")
        ),
    ))
}

/// Columns and rows of the one input, which must be NCHW, RGB, float32.
fn input_shape(path: &Path, model: &InferenceModel) -> Result<Shape> {
    let inputs = model.inputs.len();
    if inputs != 1 {
        return Err(Error::input(
            path,
            format!("has {inputs} inputs; expected one, the image"),
        ));
    }
    let fact = guarded(path, || Ok(model.input_fact(0)?.clone()))?;
    let sides: Vec<Option<usize>> = (fact.shape.dims())
        .map(|d| d.concretize().and_then(|d| d.to_usize().ok()))
        .collect();
    let shown = || {
        let side = |s: &Option<usize>| s.map_or("?".into(), |n| n.to_string());
        sides.iter().map(side).collect::<Vec<_>>().join(" x ")
    };
    let [batch, channels, height, width] = sides[..] else {
        return Err(Error::input(
            path,
            format!("its input is {}; expected 1 x 3 x rows x columns", shown()),
        ));
    };
    if batch.is_some_and(|n| n != 1) || channels.is_some_and(|n| n != 3) {
        let last = match width {
            Some(3) => ": channels come last there, export them first (NCHW)",
            _ => "",
        };
        return Err(Error::input(
            path,
            format!(
                "its input is {}; expected 1 x 3 x rows x columns{last}",
                shown()
            ),
        ));
    }
    let kind = fact.datum_type.concretize();
    if let Some(kind) = kind.filter(|k| *k != f32::datum_type()) {
        return Err(Error::input(
            path,
            format!("its input is of {kind:?}; expected float32. Export it in single precision"),
        ));
    }
    Ok(Shape { width, height })
}

/// What tract says, as an error of the file; a panic of tract's on a damaged file is one as well.
fn guarded<T>(path: &Path, work: impl FnOnce() -> TractResult<T>) -> Result<T> {
    let cure = "export it again (torch.onnx.export with opset 17 and a stated size), or simplify it (onnxsim)";
    match catch_unwind(AssertUnwindSafe(work)) {
        Ok(Ok(done)) => Ok(done),
        Ok(Err(e)) => Err(Error::input(
            path,
            format!("the runtime (tract) cannot use it: {e:#}; {cure}"),
        )),
        Err(_) => Err(Error::input(
            path,
            format!("the runtime (tract) fails on it: it is damaged, or beyond tract; {cure}"),
        )),
    }
}
