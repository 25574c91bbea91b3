# docker build -t splitknit .
# docker run --rm -v "$PWD:/data" --user "$(id -u):$(id -g)" splitknit             # the demonstration, into ./demo
# docker run --rm -v "$PWD:/data" --user "$(id -u):$(id -g)" splitknit reconstruct my_capture --out my_result
FROM python:3.13-slim AS build
COPY pyproject.toml README.md LICENSE /source/
COPY src /source/src
RUN pip wheel --no-cache-dir --no-deps --wheel-dir /wheels /source

FROM python:3.13-slim
COPY constraints.txt /tmp/
COPY --from=build /wheels /wheels
# Versions and hashes are those of constraints.txt, as in the Makefile; only a newer pip takes hashes from there
RUN sed -n '/^pip==/,/[^\\]$/p' /tmp/constraints.txt > /tmp/pip.txt \
    && pip install --no-cache-dir --require-hashes -r /tmp/pip.txt \
    && pip install --no-cache-dir --no-deps /wheels/*.whl \
    && pip install --no-cache-dir --require-hashes --constraint /tmp/constraints.txt 'splitknit[plot]' \
    && rm -r /wheels /tmp/constraints.txt /tmp/pip.txt \
    && useradd --uid 10001 splitknit \
    && install --directory --owner splitknit /data
USER 10001
WORKDIR /data
ENV HOME=/tmp
ENTRYPOINT ["splitknit"]
CMD ["demo", "--out", "demo"]
