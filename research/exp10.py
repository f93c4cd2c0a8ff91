import sys; sys.path.insert(0,"/tmp/e60")
from exp1 import *
for seed in range(int(sys.argv[1]),int(sys.argv[2])):
    size=None if sys.argv[3]=="drawn" else int(sys.argv[3])
    try:
        s=random_scan(seed,size,CACHE); A,p=s.A,s.p
        out={"seed":seed,"family":s.family,"path":s.path,"views":len(A),"photons":s.photons,"n":max(A.domain_shape)}
        best=[]; times=[]
        for relax in (0.3,1.0):
            errs=[]; t=time.perf_counter(); marks=[]
            def cb(st):
                if st.update+1==len(A): errs.append(s.error(st.volume)); marks.append(time.perf_counter())
                return len(errs)>4 and errs[-1]>1.03*min(errs)
            sart(A,p,iterations=20,relaxation=relax,nonnegative=True,callback=cb)
            best.append((min(errs),int(np.argmin(errs))+1)); times.append((marks[-1]-t)/len(marks))
        out["sart"]=min(best); out["t_pass"]=min(times)
        t=time.perf_counter(); v=fast(A,p,photons=s.photons); out["t_fast"]=time.perf_counter()-t; out["fast"]=s.error(v.array)
        print(json.dumps(out),flush=True)
    except Exception as e: print(seed,repr(e),file=sys.stderr)
