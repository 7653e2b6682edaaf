//! Where the panoramas are taken: at eye height, in free space, spread over every room.

use super::apartment::Apartment;
use super::options::SynthOptions;
use crate::core::geometry::{Camera, Projection};
use crate::core::sampling::KeyedRng;
use crate::error::{Error, Result};
use glam::{Mat3, Vec2, Vec3};

/// A camera of the scene.
pub struct SynthView {
    /// Name of its files.
    pub stem: String,
    /// Pose and size.
    pub camera: Camera,
    /// Held out for evaluation.
    pub held_out: bool,
}

/// Metres a camera keeps from furniture and walls, tried in turn.
const CLEARANCES: [f32; 4] = [0.45, 0.35, 0.25, 0.15];
/// Candidates per camera; the one farthest from all earlier cameras of the room wins (Mitchell's
/// best candidate).
const CANDIDATES: usize = 200;

/// Places all cameras, taking turns among the rooms and spreading the held-out ones evenly.
///
/// # Errors
/// If there are more views than places.
pub fn place(apartment: &Apartment, options: &SynthOptions) -> Result<Vec<SynthView>> {
    let mut placed: Vec<(usize, Vec2)> = Vec::new();
    let mut views = Vec::new();
    for i in 0..options.views {
        let room = i % apartment.rooms.len();
        let mut rng = KeyedRng::new(options.seed, 50_000 + i as u64);
        let r = &apartment.rooms[room];
        let candidate = CLEARANCES.iter().find_map(|&clearance| {
            let draws: Vec<Vec2> = (0..CANDIDATES)
                .map(|_| Vec2::new(r.x + r.size.x * rng.next_f32(), r.size.z * rng.next_f32()))
                .collect();
            let free = draws
                .into_iter()
                .filter(|p| apartment.is_free(room, *p, clearance));
            let lonely = |p: &Vec2| {
                placed
                    .iter()
                    .filter(|(k, _)| *k == room)
                    .map(|(_, q)| q.distance(*p))
                    .fold(f32::INFINITY, f32::min)
            };
            free.max_by(|a, b| lonely(a).total_cmp(&lonely(b)))
        });
        let Some(p) = candidate else {
            return Err(Error::Failed(format!(
                "synth: room {room} has no free place for a camera with seed {}",
                options.seed
            )));
        };
        placed.push((room, p));
        let yaw = std::f32::consts::TAU * rng.next_f32();
        let height = 1.42 + 0.22 * rng.next_f32();
        let camera = Camera {
            projection: Projection::Equirectangular,
            width: options.width,
            height: options.width / 2,
            world_from_camera: Mat3::from_rotation_y(yaw),
            position: Vec3::new(p.x, height, p.y),
        };
        // Bresenham's spread: view i is held out where the running share steps up; rooms are
        // visited in turn, so the share is counted over visits of the same room
        let (visit, rooms) = (i / apartment.rooms.len(), apartment.rooms.len());
        let order = room * options.views.div_ceil(rooms) + visit;
        let share = |n: usize| n * options.test_views / options.views;
        views.push(SynthView {
            stem: format!("{i:03}"),
            camera,
            held_out: share(order + 1) > share(order),
        });
    }
    // rounding may leave a few too many or too few
    let mut count = views.iter().filter(|v| v.held_out).count();
    for v in views.iter_mut().rev() {
        if count > options.test_views && v.held_out {
            v.held_out = false;
            count -= 1;
        } else if count < options.test_views && !v.held_out {
            v.held_out = true;
            count += 1;
        }
    }
    Ok(views)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cameras_stand_in_free_space_and_the_split_is_as_asked() {
        for seed in 0..12 {
            let options = SynthOptions {
                seed,
                ..SynthOptions::default()
            };
            let apartment = Apartment::new(&options);
            let views = place(&apartment, &options).expect("places");
            assert_eq!(views.len(), 40);
            assert_eq!(views.iter().filter(|v| v.held_out).count(), 16);
            for (i, v) in views.iter().enumerate() {
                let p = Vec2::new(v.camera.position.x, v.camera.position.z);
                assert!(apartment.is_free(i % 3, p, 0.15), "seed {seed} view {i}");
            }
            for room in 0..3 {
                let train = views
                    .iter()
                    .enumerate()
                    .filter(|(i, v)| i % 3 == room && !v.held_out)
                    .count();
                assert!(
                    train >= 5,
                    "seed {seed}: room {room} has {train} training views"
                );
            }
        }
    }
}
