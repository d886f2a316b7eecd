//! Which sites come first: those that the start view shows.
//!
//! Until the first round over all sites ends, most of a large scene shows a first estimate. Whoever opens it looks at a small
//! part of it, which is there in a fraction of that time.

use rayon::prelude::*;

use super::atlas::Atlas;
use super::sites::{NONE, Sites};
use crate::geometry::{Accel, Ray};
use crate::scene::Scene;

/// Columns and rows of looks.
const LOOKS: [u32; 2] = [256, 192];
/// Panes that a look passes at most.
const PANES_MAX: u32 = 8;
/// Sites around one that a look met which belong to the view as well: pixels lie between looks, and what is shown is linear
/// between sites.
const AROUND: u32 = 2;

/// Per site whether the first camera of the scene sees it; nobody knows of any where there is none. `site_of`: each element's
/// front and back.
pub fn ahead(
    (scene, accel): (&Scene, &Accel),
    atlas: &Atlas,
    sites: &Sites,
    site_of: &[[u32; 2]],
) -> Vec<bool> {
    let mut ahead = vec![false; sites.all().len()];
    let Some(view) = scene.cameras.first() else { return ahead };
    let frame = view.camera.frame(LOOKS[0], LOOKS[1]);
    let met: Vec<Vec<u32>> = (0..LOOKS[1])
        .into_par_iter()
        .map(|y| {
            let mut met = Vec::new();
            for x in 0..LOOKS[0] {
                let way = frame.direction(x as f32 + 0.5, y as f32 + 0.5);
                let mut ray = Ray::new(frame.eye, way);
                for _ in 0..PANES_MAX {
                    let Some(hit) = accel.intersect_seen(scene, &ray) else { break };
                    let [a, b, c] = scene.mesh.corners(hit.triangle);
                    let back = (b - a).cross(c - a).dot(way) > 0.0;
                    let element = atlas.element_at(hit.triangle, hit.b1, hit.b2) as usize;
                    met.extend(site_of.get(element).map(|sides| sides[usize::from(back)]));
                    if !scene.material_of(hit.triangle).is_transparent() {
                        break;
                    }
                    (ray.t_min, ray.ignore) = (hit.t * (1.0 + 1e-5), hit.triangle);
                }
            }
            met
        })
        .collect();
    let mut found: Vec<u32> = met.into_iter().flatten().collect();
    for turn in 0..=AROUND {
        found.retain(|&site| site != NONE && !std::mem::replace(&mut ahead[site as usize], true));
        if turn < AROUND {
            found = found.par_iter().flat_map_iter(|&site| sites.links_of(site)).collect();
        }
    }
    ahead
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::illumination::bake::{atlas_of, sides_of};
    use crate::illumination::test_scenes::{cube, lambert, scene};
    use glam::Vec3;

    /// Of a room its start view shows some of the walls, from inside, all of what is shown and no other side.
    #[test]
    fn the_start_view_comes_first() {
        let room = scene(cube(Vec3::ZERO, 2.0, false), vec![lambert(0.5, 0.0)], Vec::new());
        let mut room = room;
        room.cameras[0].camera.eye = Vec3::new(1.0, 1.0, 1.9);
        room.cameras[0].camera.target = Vec3::new(1.0, 1.0, 0.0);
        let accel = Accel::build(&room);
        let atlas = atlas_of(&room, 4000, &|_| true, &|| true).expect("wanted");
        let sites = Sites::new(&atlas, &sides_of(&atlas));
        let mut site_of = vec![[NONE; 2]; atlas.elements.len()];
        for (i, site) in sites.all().iter().enumerate() {
            site_of[site.element as usize][usize::from(site.back)] = i as u32;
        }
        let first = ahead((&room, &accel), &atlas, &sites, &site_of);
        let frame = room.cameras[0].camera.frame(64, 48);
        let (mut shown, mut hidden) = (0, 0);
        for (site, first) in sites.all().iter().zip(&first) {
            let faces = (frame.eye - site.position).dot(site.normal) > 0.0;
            let within = frame
                .project(site.position)
                .is_some_and(|(x, y, _)| (1.0..63.0).contains(&x) && (1.0..47.0).contains(&y));
            assert!(!(faces && within) || *first, "{site:?}");
            (shown, hidden) = (shown + u32::from(*first), hidden + u32::from(!*first));
        }
        assert!(shown > 300 && hidden > shown, "{shown} {hidden}");
        room.cameras.clear();
        assert!(!ahead((&room, &accel), &atlas, &sites, &site_of).iter().any(|a| *a));
    }
}
