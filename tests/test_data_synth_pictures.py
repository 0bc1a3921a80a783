import numpy as np
import pytest
from matplotlib.image import imread

from data_synth import picture_terms
from data_synth.machines import open_shop
from data_synth.picture import draw
from data_synth.picture_terms import draw_angles, draw_location, draw_motion, motion_axes
from data_synth.picture_volume import draw_volume
from data_synth.recipe import Maker, Recipe
from data_synth.tip import tip_deviation


def draw_all(shop, folder, seed=0, kind="shop"):
    made = Maker(shop, Recipe(1, 2.0, seed, (kind,)))(0)
    run, machine = made.run, shop.machine
    folder.mkdir()
    middle = tip_deviation(machine, run.terms)[:, 0]
    draw(folder / "overview.png", machine.name, run, middle - middle[:1])
    series = (machine, "r", run.terms_time_s, run.terms)
    for axis in motion_axes(machine):
        draw_motion(folder / f"motion_{axis}.png", *series, axis)
    draw_location(folder / "location.png", *series)
    draw_angles(folder / "angles.png", *series)
    draw_volume(folder / "volume.png", machine, "largest drift", made.peak)
    return folder


@pytest.fixture(scope="module")
def pictures(tmp_path_factory):
    return draw_all(open_shop("vmc3"), tmp_path_factory.mktemp("pictures") / "one")


@pytest.mark.parametrize("name", ["trunnion5", "gantry3"])
def test_machines_of_other_kinds_have_all_pictures(name, tmp_path):
    folder = draw_all(open_shop(name), tmp_path / name)
    for path in folder.iterdir():
        image = imread(path)
        assert image.shape[0] > 300
        assert image.shape[1] > 900
        assert image[..., :3].std() > 0.05, path.name  # something is drawn


def test_the_same_data_give_the_same_bytes_and_other_data_others(pictures, tmp_path):
    shop = open_shop("vmc3")
    same, other = draw_all(shop, tmp_path / "same"), draw_all(shop, tmp_path / "other", seed=1)
    for path in pictures.iterdir():
        assert path.read_bytes() == (same / path.name).read_bytes(), path.name
        assert path.read_bytes() != (other / path.name).read_bytes(), path.name


def test_rotary_axes_have_a_picture_of_their_own():
    assert motion_axes(open_shop("vmc3").machine) == ["Z"]
    assert motion_axes(open_shop("trunnion5").machine) == ["Z", "A", "C"]


def test_the_angles_are_those_of_the_paper(pictures, tmp_path):
    """Figure 5 shows γ of X, α and β of Z (Su, Li and Wang 2001)."""
    shop = open_shop("seed3")
    run = Maker(shop, Recipe(1, 1.0, 0, ("shop",)))(0).run
    drawn = draw_angles(tmp_path / "angles.png", shop.machine, "r", run.terms_time_s, run.terms)
    assert sorted(drawn) == ["EA0Z", "EB0Z", "EC0X"]
    assert draw_location(tmp_path / "location.png", shop.machine, "r", run.terms_time_s, run.terms) == "Y"


def test_a_panel_of_rounding_is_flat():
    """A curve a millionth as high as its neighbours must not fill its panel."""
    _, panels = picture_terms._six("panels")
    values = np.stack([np.linspace(0.0, size, 5) for size in (10.0, 1e-6, 0.0)], axis=1)
    picture_terms._even(panels[:3], values)
    heights = [float(np.ptp(panel.get_ylim())) for panel in panels[:3]]
    assert heights[0] == pytest.approx(11.0)
    assert heights[1] == heights[2] == pytest.approx(0.22)


def test_readings_that_are_missing_leave_gaps(tmp_path):
    shop = open_shop("vmc3")
    run = Maker(shop, Recipe(1, 1.0, 0, ("shop",)))(0).run
    for values in run.sensors.values():
        values[10:20] = np.nan
    draw(tmp_path / "overview.png", "vmc3", run, np.zeros((len(run.terms_time_s), 3)))
    assert (tmp_path / "overview.png").stat().st_size > 10_000
