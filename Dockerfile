# The command bayes-sensor in a container, with the versions that are tested together:
#   docker build -t bayes-sensor .
#   docker run --rm -v "$PWD:/data" bayes-sensor analyze campaign.toml --out results
FROM python:3.12-slim

WORKDIR /opt/bayes_sensor
COPY pyproject.toml README.md LICENSE constraints-3.12.txt ./
COPY bayes_sensor bayes_sensor
RUN python -m pip install --no-cache-dir -c constraints-3.12.txt ".[formats]"

# compiled code is kept between commands; results belong to whoever runs the container
ENV OMP_NUM_THREADS=1 MPLCONFIGDIR=/tmp/matplotlib NUMBA_CACHE_DIR=/tmp/numba
WORKDIR /data
ENTRYPOINT ["bayes-sensor"]
CMD ["--help"]
