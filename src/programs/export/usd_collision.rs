//! Convex bodies in USD: meshes of UsdPhysics that simulators collide by and renderers do not show.

use super::hulls::ObjectHulls;
use super::objects::unlike;
use super::usd_text::list;
use glam::Vec3;
use std::collections::BTreeSet;
use std::fmt::Write;

/// Appends the hulls of an object whose prim is `prim`, a prim each, at the object's place.
pub(super) fn hull_prims(
    s: &mut String,
    object: &ObjectHulls,
    prim: &str,
    taken: &mut BTreeSet<String>,
) {
    for (k, hull) in (1..).zip(&object.hulls) {
        let name = unlike(&format!("{prim}_collision_{k:02}"), '_', taken);
        let _ = writeln!(
            s,
            "    def Mesh \"{name}\" (\n        customData = {{\n            double error = {}\n        }}\n        \
             prepend apiSchemas = [\"PhysicsCollisionAPI\", \"PhysicsMeshCollisionAPI\"]\n    )\n    {{",
            object.error
        );
        let p = object.pivot;
        if p != Vec3::ZERO {
            let _ = writeln!(
                s,
                "        double3 xformOp:translate = ({}, {}, {})\n        uniform token[] xformOpOrder = [\"xformOp:translate\"]",
                p.x, p.y, p.z
            );
        }
        s.push_str(
            "        uniform token physics:approximation = \"convexHull\"\n        uniform token purpose = \"guide\"\n        \
             uniform token subdivisionScheme = \"none\"\n",
        );
        let (low, high) = hull.bounds();
        let vector = |v: &Vec3| format!("({}, {}, {})", v.x, v.y, v.z);
        let extent = [low, high];
        list(s, "float3[] extent", extent.iter().map(vector), "");
        let threes = hull.triangles.iter().map(|_| "3".to_owned());
        list(s, "int[] faceVertexCounts", threes, "");
        let corners = hull.triangles.iter().flatten().map(u32::to_string);
        list(s, "int[] faceVertexIndices", corners, "");
        list(s, "point3f[] points", hull.positions.iter().map(vector), "");
        s.push_str("    }\n\n");
    }
}

#[cfg(test)]
mod tests {
    use crate::programs::export::{UsdOptions, object_hulls, write_usd};
    use crate::solution::MeshPart;
    use crate::solution::tests::small_solution;

    #[test]
    fn convex_bodies_are_colliders_that_nobody_sees() {
        let solution = small_solution();
        let parts = [MeshPart::standing(
            "a rug".into(),
            &solution.mesh,
            vec![0, 1],
        )];
        let hulls = object_hulls(&solution.mesh, &parts);
        let folder = tempfile::tempdir().expect("temp");
        let options = UsdOptions {
            parts: &parts,
            hulls: &hulls,
            lights: false,
        };
        write_usd(folder.path(), &solution, options).expect("writes");
        let text = std::fs::read_to_string(folder.path().join("scene.usda")).expect("reads");
        assert_eq!(text.matches('{').count(), text.matches('}').count());
        let (shown, body) = text
            .split_once("def Mesh \"a_rug_collision_01\"")
            .expect("a body");
        assert!(shown.contains("def Mesh \"a_rug\"") && !shown.contains("Physics"));
        for said in [
            "\"PhysicsCollisionAPI\", \"PhysicsMeshCollisionAPI\"",
            "physics:approximation = \"convexHull\"",
            "purpose = \"guide\"",
            "xformOp:translate = (0, 0.1, ",
        ] {
            assert!(body.contains(said), "{said}");
        }
        let corners = hulls[0].hulls[0].positions.len();
        let points = body
            .lines()
            .find(|l| l.contains("points ="))
            .expect("points");
        assert_eq!(points.matches('(').count(), corners);
    }
}
