//! A prim's own transform: `xformOpOrder` lists operations, the outermost first (UsdGeomXformable).
//!
//! USD writes row vectors times matrices; here columns, so that the list reads as a product. Called
//! by `usd_mesh`.

use super::usd_layer::Value;
use super::usd_stage::Composed;
use glam::{DMat4, DQuat, DVec3};

/// A prim's own transform.
pub struct Local {
    /// Points of the prim to points of its parent.
    pub matrix: DMat4,
    /// The parents' transforms do not apply.
    pub resets: bool,
}

/// Reads a prim's transform.
///
/// # Errors
/// An operation that is not known or has no value.
pub fn local(prim: &Composed) -> Result<Local, String> {
    let mut local = Local {
        matrix: DMat4::IDENTITY,
        resets: false,
    };
    for op in prim.value("xformOpOrder").map_or(&[][..], Value::list) {
        let name = op.text().ok_or("xformOpOrder: expected names")?;
        if name == "!resetXformStack!" {
            local = Local {
                matrix: DMat4::IDENTITY,
                resets: true,
            };
            continue;
        }
        let (property, inverted) = match name.strip_prefix("!invert!") {
            Some(property) => (property, true),
            None => (name, false),
        };
        let matrix = operation(property, &prim.numbers(property))?;
        local.matrix *= match inverted {
            true if matrix.determinant() == 0.0 => {
                return Err(format!("{name}: nothing undoes it; export with one matrix"));
            }
            true => matrix.inverse(),
            false => matrix,
        };
    }
    Ok(local)
}

/// `xformOp:kind:suffix` with its numbers.
fn operation(name: &str, n: &[f64]) -> Result<DMat4, String> {
    let kind = name.split(':').nth(1).unwrap_or("");
    let known = match kind.split_at(kind.len() - trailing_axes(kind)) {
        ("transform", "") => matrix(n),
        ("orient", "") => quaternion(n).map(DMat4::from_quat),
        ("translate", axes) => along(axes, n, 0.0).map(DMat4::from_translation),
        ("scale", axes) => along(axes, n, 1.0).map(DMat4::from_scale),
        ("rotate", axes) => rotation(axes, n),
        _ => None,
    };
    known.ok_or_else(|| {
        format!(
            "{name} with {} numbers is not known here; export with one matrix",
            n.len()
        )
    })
}

/// How many letters of axes end the name.
fn trailing_axes(kind: &str) -> usize {
    kind.bytes()
        .rev()
        .take_while(|b| b"XYZ".contains(b))
        .count()
}

fn matrix(n: &[f64]) -> Option<DMat4> {
    let m: [f64; 16] = n.try_into().ok()?;
    Some(DMat4::from_cols_array(&m))
}

/// A rotation from (w, x, y, z).
#[must_use]
pub fn quaternion(n: &[f64]) -> Option<DQuat> {
    let &[w, x, y, z] = n else { return None };
    let q = DQuat::from_xyzw(x, y, z, w);
    (q.length_squared() > 0.0).then(|| q.normalize())
}

/// Three numbers, or one for the axis stated and `rest` for the others.
fn along(axis: &str, n: &[f64], rest: f64) -> Option<DVec3> {
    match (axis, n) {
        ("", &[x, y, z]) => Some(DVec3::new(x, y, z)),
        ("X", &[x]) => Some(DVec3::new(x, rest, rest)),
        ("Y", &[y]) => Some(DVec3::new(rest, y, rest)),
        ("Z", &[z]) => Some(DVec3::new(rest, rest, z)),
        _ => None,
    }
}

/// Degrees about the axes stated, the first of them applied first; three numbers are x, y, z.
fn rotation(axes: &str, n: &[f64]) -> Option<DMat4> {
    let all_three = ["X", "Y", "Z"].iter().all(|a| axes.contains(a));
    if axes.len() != n.len() || !(n.len() == 1 || n.len() == 3 && all_three) {
        return None;
    }
    let mut all = DMat4::IDENTITY;
    for axis in axes.bytes() {
        let place = usize::from(axis - b'X');
        let degrees = if n.len() == 1 { n[0] } else { n[place] };
        all = DMat4::from_axis_angle(DVec3::AXES[place], degrees.to_radians()) * all;
    }
    Some(all)
}
