//! Which sites come first: those that the start view shows.
//!
//! Until the first round over all sites ends, most of a large scene shows a first estimate. Whoever opens it looks at a small
//! part of it, which is there in a fraction of that time. The first estimate, too, takes most of its samples there.

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

/// Per site whether the first camera of the scene sees it or what is beside it; nobody knows of any where there is none. `site_of`:
/// each element's front and back ([`super::sites::by_element`]).
pub fn ahead(seen_by: (&Scene, &Accel), atlas: &Atlas, sites: &Sites, site_of: &[[u32; 2]]) -> Vec<bool> {
    let mut ahead = vec![false; sites.all().len()];
    let mut found = met(seen_by, atlas, site_of, LOOKS);
    for turn in 0..=AROUND {
        found.retain(|&site| !std::mem::replace(&mut ahead[site as usize], true));
        if turn < AROUND {
            let beside = found.par_iter().flat_map_iter(|&site| sites.links_of(site));
            found = beside.filter(|site| *site != NONE).collect();
        }
    }
    ahead
}

/// The sites that the first camera of the scene meets by so many columns and rows of looks; one may be there several times.
pub fn met(
    (scene, accel): (&Scene, &Accel),
    atlas: &Atlas,
    site_of: &[[u32; 2]],
    [columns, rows]: [u32; 2],
) -> Vec<u32> {
    let Some(view) = scene.cameras.first() else { return Vec::new() };
    let frame = view.camera.frame(columns, rows);
    let row = |y: u32| {
        let mut met = Vec::new();
        for x in 0..columns {
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
        met.retain(|site| *site != NONE);
        met
    };
    let met: Vec<Vec<u32>> = (0..rows).into_par_iter().map(row).collect();
    met.concat()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::illumination::bake::{atlas_of, sides_of};
    use crate::illumination::sites::by_element;
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
        let site_of = by_element(sites.all(), atlas.elements.len());
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
