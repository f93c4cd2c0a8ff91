# twinct with all its extras, on a bare Debian with Python:
#   docker build -t twinct .
#   docker run --rm -v "$PWD:/work" twinct demo
# EXTRAS chooses others: docker build --build-arg EXTRAS=robots -t twinct .
FROM python:3.12-slim-bookworm AS build
WORKDIR /source
COPY . .
RUN apt-get update && apt-get install -y --no-install-recommends g++ \
 && pip install --no-cache-dir "setuptools>=77" wheel \
 && pip wheel --no-cache-dir --no-deps --no-build-isolation --wheel-dir /dist . \
 && pip wheel --no-cache-dir --no-deps --wheel-dir /dist ./packaging/ros_types

FROM python:3.12-slim-bookworm
ARG EXTRAS=all
COPY tools/system-libraries /tmp/
RUN apt-get update \
 && apt-get install -y --no-install-recommends $(bash /tmp/system-libraries names | tr ' ' '\n' | grep -v python3-venv) \
 && rm -rf /var/lib/apt/lists/* /tmp/system-libraries
RUN --mount=type=bind,from=build,source=/dist,target=/dist \
    pip install --no-cache-dir "$(echo /dist/twinct-*.whl)[$EXTRAS]" \
 && pip install --no-cache-dir --no-deps /dist/twinct_ros_types-*.whl
# Kernels are compiled at the first run, for the processor that runs them; a volume here keeps them.
RUN useradd --create-home user && mkdir /work && chown user /work
USER user
ENV NUMBA_CACHE_DIR=/home/user/.cache/numba
WORKDIR /work
ENTRYPOINT ["twinct"]
CMD ["--help"]
