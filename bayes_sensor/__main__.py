"""``python -m bayes_sensor`` is the command ``bayes-sensor``."""

from bayes_sensor.cli import main

if __name__ == "__main__":
    main()
