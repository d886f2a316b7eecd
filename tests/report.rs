//! The report of a walk, as a browser shows it: light and dark, on a desk and on a phone.

use std::path::Path;

use serde_json::json;

use crate::support::browser::{Browser, Page};
use crate::support::{Foveal, folder, scene};

/// Shows a report on a desk and on a phone, in light and dark: nothing sticks out, plots are as large as they are drawn for, and words
/// can be told from what is behind them.
pub fn fits_any_size(page: &mut Page, report: &Path, plots_min: usize) {
    for (width, scheme) in [(1280, "light"), (1280, "dark"), (390, "light"), (390, "dark")] {
        page.resize(width, 900, scheme, width < 500);
        page.go(&format!("file://{}", report.display()));
        page.wait("document.readyState === 'complete'");
        let what = format!("{}, {width} pixels, {scheme}", report.display());
        assert_eq!(page.eval("document.documentElement.scrollWidth <= innerWidth"), json!(true), "{what}");
        // Of each plot there is one, as large as it is drawn for.
        let plots = page.eval(
            "[...document.querySelectorAll('figure.plot')].map(f => [...f.querySelectorAll('svg')]\
             .filter(s => s.getBoundingClientRect().width > 0).length)",
        );
        assert!(
            plots.as_array().is_some_and(|p| p.len() >= plots_min && p.iter().all(|n| *n == 1)),
            "{what}: {plots}"
        );
        let contrast = page.eval(
            "(() => { const light = c => { const [r, g, b] = c.match(/[\\d.]+/g).map(v => v / 255)\
             .map(v => v <= 0.03928 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);\
             return 0.2126 * r + 0.7152 * g + 0.0722 * b; };\
             const back = light(getComputedStyle(document.body).backgroundColor);\
             return Math.min(...[...document.querySelectorAll('h1,h2,p,td,th,figcaption,.name,.value')].map(e => {\
             const c = light(getComputedStyle(e).color);\
             return (Math.max(c, back) + 0.05) / (Math.min(c, back) + 0.05); })); })()",
        );
        assert!(contrast.as_f64().is_some_and(|c| c >= 4.5), "{what}: contrast {contrast}");
    }
    // Where and when it was made.
    let made = page.eval("document.querySelector('h1 + p').textContent");
    assert!(made.as_str().is_some_and(|m| m.starts_with("foveal ") && m.contains(" core")), "{made}");
    assert!(page.errors.is_empty(), "{:?}", page.errors);
    let is_here = |address: &String| address.starts_with("file:") || address.starts_with("data:");
    assert!(page.requests.iter().all(is_here), "{:?}", page.requests);
}

/// Nothing is fetched, and two pictures lie under one line.
#[test]
fn a_report_is_shown_at_any_size() {
    let Some(browser) = Browser::open() else { return };
    let out = folder("report");
    Foveal::new("walk --quick --frames 12 --fps 60 --size 480x360 --workers 1 --out")
        .arg(&out)
        .arg(scene("box"))
        .ok();
    let mut page = browser.page();
    fits_any_size(&mut page, &out.join("report.html"), 3);
    // The line moves, and the difference is another picture.
    let seen = page.eval(
        "(() => { const ab = document.querySelector('.ab'), layers = ab.querySelector('.layers');\
         const [under, over] = layers.querySelectorAll('img'), cut = ab.querySelector('.cut');\
         const all = JSON.parse(ab.querySelector('script').textContent);\
         const pick = mode => ab.querySelector(`input[value=${mode}]`).click();\
         const seen = [ab.classList.contains('live'), under.src === ab.dataset.reference, !over.hidden];\
         pick('flip'); seen.push(under.src === all[0].flip && over.hidden && cut.disabled);\
         pick('shown'); seen.push(under.src === all[0].shown);\
         pick('split'); cut.value = 250; cut.dispatchEvent(new Event('input'));\
         seen.push(!over.hidden && layers.style.getPropertyValue('--cut') === '25%');\
         return seen; })()",
    );
    assert_eq!(seen, json!([true, true, true, true, true, true]));
    assert!(page.errors.is_empty(), "{:?}", page.errors);
}
