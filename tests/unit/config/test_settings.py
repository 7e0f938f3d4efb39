"""A wrong variable is named with its value and what it may be; secrets are not shown."""

import pytest

from solmap.config.records import ConfigError
from solmap.config.settings import Settings, unknown_variables


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("SOLMAP_PORT", "abc", "it should be a valid integer"),
        ("SOLMAP_PORT", "70000", "it should be less than or equal to 65535"),
        ("SOLMAP_PORT", "0", "it should be greater than or equal to 1"),
        ("SOLMAP_ENGINE_PORT", "-1", "it should be greater than or equal to 1"),
        ("SOLMAP_STORE_CACHE_GB", "nan", "it should be a finite number"),
        ("SOLMAP_TASK_RUNNER", "ray", "it should be 'threads' or 'dask'"),
        ("SOLMAP_TASK_WORKERS", "0", "it should be greater than or equal to 1"),
        ("SOLMAP_DOWNLINK_CRON", "daily", "it should have five fields"),
        ("SOLMAP_DEBUG", "perhaps", "it should be a valid boolean"),
    ],
)
def test_a_wrong_value_is_one_line(name, value, reason, monkeypatch):
    monkeypatch.setenv(name, value)
    with pytest.raises(ConfigError) as refused:
        Settings()
    assert str(refused.value).startswith(f"{name}={value}: {reason}")
    assert "\n" not in str(refused.value)


def test_a_secret_is_not_shown():
    with pytest.raises(ConfigError) as refused:
        Settings(catalogue_url=b"\xffsecret")
    assert "SOLMAP_CATALOGUE_URL: it should be a valid string" in str(refused.value)
    assert "secret" not in str(refused.value)


def test_an_empty_variable_is_not_set(monkeypatch):
    monkeypatch.setenv("SOLMAP_STORE", "")
    assert Settings().store == Settings.model_fields["store"].default


def test_every_setting_is_passed_on_to_another_process(monkeypatch):
    given = Settings(store="x", port=1, debug=True, downlink_cron="@daily")
    for name, value in given.environment.items():
        monkeypatch.setenv(name, value)
    assert Settings() == given


def test_an_unknown_variable_is_named(monkeypatch):
    monkeypatch.setenv("SOLMAP_STOR", "x")
    assert (
        "SOLMAP_STOR is not a setting of solmap; did you mean SOLMAP_STORE?" in unknown_variables()
    )
    monkeypatch.setenv("solmap_port", "1")
    assert not [line for line in unknown_variables() if "port" in line.split()[0]]
