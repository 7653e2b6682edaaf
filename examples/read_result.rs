//! Reads a result and prints what each class is made of: `cargo run --example read_result OUT`.

use std::collections::BTreeMap;
use unbake::Solution;

fn main() -> unbake::Result<()> {
    let Some(out) = std::env::args().nth(1) else {
        return Err(unbake::Error::Usage("read_result OUT".into()));
    };
    let solution = Solution::load(out.as_ref())?;
    let size = (solution.albedo.width, solution.albedo.height);
    // labels and albedo share the atlas and, as solve writes them, its size
    let mut sums: BTreeMap<u16, ([f64; 3], u32)> = BTreeMap::new();
    if (solution.labels.width, solution.labels.height) == size {
        let observed = solution.confidence.data.iter().map(|c| c.x < 1e4);
        let texels = solution.labels.data.iter().zip(&solution.albedo.data);
        for ((class, albedo), seen) in texels.zip(observed) {
            if *class > 0 && seen {
                let (sum, count) = sums.entry(*class).or_default();
                *count += 1;
                for (s, a) in sum.iter_mut().zip(albedo.to_array()) {
                    *s += f64::from(a);
                }
            }
        }
    }
    println!(
        "{} triangles, albedo {}x{}, {:?}",
        solution.mesh.triangles.len(),
        size.0,
        size.1,
        solution.reflectance
    );
    for (class, (sum, count)) in sums {
        let [r, g, b] = sum.map(|s| s / f64::from(count));
        println!("class {class}: albedo {r:.3} {g:.3} {b:.3} over {count} texels");
    }
    Ok(())
}
