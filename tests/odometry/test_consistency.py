"""A few seeded runs; benchmarks/odometry_consistency.py does fifty."""

import consistency


def test_errors_are_as_large_as_the_covariance_says() -> None:
    config = consistency.told_noise()
    runs = [
        consistency.run(
            seed, seconds=3.5, points=4000, moments=(2.5, 3.0, 3.5), config=config
        )
        for seed in range(8)
    ]
    result = consistency.nees(runs)
    # 8 runs of 17 dimensions: the 99.9 % band of the average is about 1 +- 0.4.
    assert 0.6 < result["all"] < 1.4, result
    for name in ("rotation", "position"):
        assert result[name] < 2.0, result


def test_an_overconfident_filter_is_caught() -> None:
    """The measure itself: covariances cut to a quarter show as a NEES of four."""
    one = consistency.run(0, seconds=2.6, points=2000, moments=(2.5,))
    shrunk = consistency.Run(one.errors, one.covariances / 4.0)
    full, cut = consistency.nees([one])["all"], consistency.nees([shrunk])["all"]
    assert abs(cut / full - 4.0) < 1e-6
